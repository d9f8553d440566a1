// What is missing: the verdict, effects with their probabilities, the shape of the missing force, what each
// effect would do to the curves, what was refused and why, the error ladder, the next test.

import { get, post, run } from "./api";
import { Plot, cells, sign } from "./plots";
import type { Diagnosis, Entry, Expected, Job, Parameter, RunShort, SetUp, Status, Step, Sweep } from "./types";
import { duration, fill, h, ink, percent, quantity, short, tell, trying } from "./ui";

const VERDICTS: Record<string, string> = {
  adequate: "Adequate: nothing is missing beyond the noise and the parameters' own uncertainty.",
  missing: "Missing: ", ambiguous: "Ambiguous: the record cannot tell these apart: ",
  "outside-catalogue": "Outside the catalogue: structure is left that no known effect explains.",
};

export class Missing {
  element: HTMLElement;
  private select = h("select", { "aria-label": "Run" });
  private ask = h("button", { class: "loud", onclick: () => void this.diagnose() }, "Ask what is missing");
  private undo = h("button", { onclick: (e: Event) => void this.takeBack(e.currentTarget as HTMLButtonElement) }, "Undo");
  private verdict = h("div", { class: "verdict", role: "status" });
  private ladder = h("div", {});
  private effects = h("div", {});
  private shape = h("div", {});
  private trial = h("div", {});
  private rest = h("div", {});
  private now = h("p", { class: "quiet" });
  private answer: Diagnosis | undefined;
  private catalogue: Entry[] = [];
  private setup: SetUp | undefined;
  private steps: Step[] = [];

  constructor(private changed: () => void, private load: (sweep: Partial<Sweep>, note: string) => void) {
    this.element = h("div", { class: "two" },
      h("section", { class: "panel grow", "aria-label": "What is missing" },
        h("div", { class: "row" }, h("h2", {}, "What is missing"), this.select, this.ask, this.undo), this.now, this.verdict, this.effects, this.trial, this.shape),
      h("section", { class: "panel narrow", "aria-label": "Error ladder and what was refused" }, this.ladder, this.rest));
  }

  async show(status: Status | undefined): Promise<void> {
    const runs = (await trying(() => get<RunShort[]>("runs?limit=60"))) ?? [];
    const whole = runs.filter((r) => r.state !== "running" && r.state !== "unreadable");
    const wanted = status?.ended?.id ?? this.select.value;
    fill(this.select, whole.map((r) => h("option", { value: r.id, selected: r.id === wanted }, `${r.name}, ${r.started_utc.slice(5, 16).replace("T", " ")}`)));
    this.ask.disabled = whole.length === 0;
    await this.refresh();
    if (this.catalogue.length === 0) this.catalogue = (await trying(() => get<Entry[]>("catalogue"))) ?? [];
    if (!this.answer) this.choose();
  }

  private async refresh(): Promise<void> {
    this.setup = await trying(() => get<SetUp>("setup"));
    if (!this.setup) return;
    const effects = this.setup.model.effect ?? [];
    this.now.textContent = `Onboard model: ${this.setup.model.name}${effects.length ? ` with ${effects.map((e) => e.name).join(", ")}` : ", no effects"}`;
    this.undo.disabled = this.setup.undos === 0;
  }

  private async diagnose(): Promise<void> {
    const id = this.select.value;
    const started = await trying(() => post<Job<Diagnosis>>(`${run(id)}/diagnose`, { as_set_up: true }), this.ask);
    if (!started) return;
    this.ask.disabled = true;
    fill(this.effects); fill(this.shape); fill(this.trial); fill(this.rest); fill(this.ladder);
    let job = started;
    while (job.state === "waiting" || job.state === "running") {
      fill(this.verdict, h("span", { class: "busy", "aria-hidden": "true" }), ` Instruments, then parameters, then effects… ${duration(job.elapsed_s)}`);
      await new Promise((done) => setTimeout(done, 500));
      const next = await trying(() => get<Job<Diagnosis>>(`jobs/${started.id}`));
      if (!next) break;
      job = next;
    }
    this.ask.disabled = false;
    if (job.result) {
      this.answer = job.result;
      this.steps = (await trying(() => get<Step[]>(`${run(id)}/steps`))) ?? [];
      this.draw(job.result);
    } else fill(this.verdict, h("b", { class: "bad" }, job.error ?? "no answer"));
  }

  private draw(d: Diagnosis): void {
    const names = d.effects.map((e) => e.name);
    fill(this.verdict, h("b", {}, VERDICTS[d.verdict] ?? d.verdict, d.verdict === "missing" ? names.join(", ") : d.verdict === "ambiguous" ? [...names, ...d.ambiguous_with].join(" or ") : ""),
      h("div", { class: "quiet" }, `Error of held-out steps: ${percent(d.error_before, 2)} as given, ${percent(d.error_reidentified, 2)} re-identified, ${percent(d.error_after, 2)} after; noise floor ${percent(d.noise_floor, 2)}. ${short(d.wall_s)} s.`));
    this.drawLadder(d);
    fill(this.effects, d.effects.length > 0 && h("table", { class: "small" }, h("thead", {}, h("tr", {}, ["effect", "probability", "parameters (95 %)", "error with it", ""].map((t) => h("th", {}, t)))),
      h("tbody", {}, d.effects.map((e) => h("tr", {}, h("td", {}, h("b", {}, e.name)), h("td", {}, h("meter", { min: 0, max: 1, value: e.probability, "aria-label": "probability" }), ` ${percent(e.probability, 0)}`),
        h("td", {}, Object.entries(e.parameters).map(([name, p]) => h("div", {}, `${name} ${quantity(p.value, p.unit)} `, h("span", { class: "quiet" }, `(${short(p.low95)} to ${short(p.high95)})`)))),
        h("td", {}, percent(e.error_after, 2)),
        h("td", { class: "row" }, h("button", { onclick: () => this.try(e.name, Object.fromEntries(Object.entries(e.parameters).map(([n, p]) => [n, p.value]))) }, "Try"),
          h("button", { class: "loud", "data-add": e.name, onclick: (event: Event) => void this.add(e.name, Object.fromEntries(Object.entries(e.parameters).map(([n, p]) => [n, p.value])), event.currentTarget as HTMLButtonElement) }, "Add")))))));
    this.drawShape(d);
    if (d.effects[0]) this.try(d.effects[0].name, Object.fromEntries(Object.entries(d.effects[0].parameters).map(([n, p]) => [n, p.value])));
    else this.choose();
    const test = d.next_test;
    fill(this.rest,
      test && [h("h3", {}, "Next test"), h("p", {}, h("b", {}, test.title), " ", test.reason, test.expected_discrimination > 0 ? ` Expected difference: ${short(test.expected_discrimination)} times the noise.` : ""),
        test.sweep && h("button", { "data-action": "load-next-test", onclick: () => this.take(test) }, "Load into Sweep")],
      h("details", { open: d.refused.length < 6 }, h("summary", {}, `Refused: ${d.refused.length}`), h("ul", { class: "refused" }, d.refused.map((r) => h("li", {}, h("b", {}, r.name), ": ", r.reason)))),
      d.reidentified.length > 0 && h("details", {}, h("summary", {}, "Re-identified numbers"), h("table", { class: "small" }, h("tbody", {}, d.reidentified.map((r) => h("tr", {}, h("td", {}, r.key), h("td", {}, short(r.nominal)), h("td", {}, "→ ", short(r.value)), h("td", { class: "quiet" }, `${short(r.low95)} to ${short(r.high95)}`, r.at_limit && h("b", {}, ", at the limit of what its uncertainty allows"))))))),
      d.not_identifiable.length > 0 && h("p", { class: "quiet" }, `This record cannot tell: ${d.not_identifiable.join("; ")}.`),
      d.notes.map((note) => h("p", { class: "quiet" }, note)));
  }

  private drawLadder(d: Diagnosis): void {
    const worst = Math.max(...d.ladder.map((r) => r.held_out), d.noise_floor);
    // Logarithmic: the last step is as long as the first where both divide the error alike.
    const low = Math.log10(Math.max(d.noise_floor, 1e-6) / 1.6), span = Math.log10(worst * 1.1) - low;
    const share = (x: number) => `${(100 * Math.max(0.01, (Math.log10(Math.max(x, 1e-6)) - low) / span)).toFixed(1)}%`;
    const bar = (label: string, value: number, kind: string) => {
      const inner = h("div", { class: `bar ${kind}` });
      inner.style.width = share(value);
      return h("li", {}, h("div", { class: "row" }, h("span", {}, label), h("b", { class: "spring-right" }, percent(value, 2))), h("div", { class: "rail" }, inner));
    };
    fill(this.ladder, h("h3", {}, "Error ladder (held-out steps)"), h("ol", { class: "ladder" }, d.ladder.map((r, i) => bar(r.model, r.held_out, i === d.ladder.length - 1 ? "last" : "")), bar("noise floor", d.noise_floor, "floor")));
  }

  private drawShape(d: Diagnosis): void {
    const f = d.missing_force;
    if (!f) { fill(this.shape); return; }
    const top = Math.max(1e-12, ...f.force_n.flat().map((v) => Math.abs(v ?? 0)));
    const columns = f.velocity_m_s.map((v, j) => (j % Math.ceil(f.velocity_m_s.length / 8) === 0 ? short(1e3 * v) : ""));
    const rows = f.displacement_m.map((x, i) => ({
      label: `${(1e3 * x).toFixed(1)}`,
      cells: f.force_n[i].map((value, j) => ({ value, title: `D ${(1e3 * x).toFixed(1)} mm, D′ ${(1e3 * f.velocity_m_s[j]).toFixed(0)} mm/s: ${short(value)} ± ${short(f.sigma_n[i]?.[j] ?? null)} N` })),
    })).reverse();
    fill(this.shape, h("h3", {}, "Shape of the missing force"),
      cells(rows, columns, (v) => sign(v / top), `Force left over after re-identification: D in mm down, D′ in mm/s across; blue negative, vermilion positive, ${short(top)} N at most. The surface explains ${percent(f.explained_by_surface, 0)} of it; ${percent(f.power_in_contact, 0)} lies in contact.`),
      f.expression && h("p", {}, "Draft: ", h("code", {}, f.expression.expression), ` explains ${percent(f.expression.explains, 0)} `,
        h("button", { onclick: (e: Event) => void this.add("expression", f.expression?.parameters ?? {}, e.currentTarget as HTMLButtonElement, f.expression?.expression) }, "Add as expression")));
  }

  /** Any effect of the catalogue can be tried, also one that was not named. */
  private choose(): void {
    if (this.catalogue.length === 0) return;
    const select = h("select", { "aria-label": "Effect to try", onchange: () => this.try(select.value, {}) }, h("option", { value: "" }, "an effect of the catalogue…"), this.catalogue.filter((e) => e.name !== "expression").map((e) => h("option", { value: e.name }, e.name)));
    fill(this.trial, h("h3", {}, "Try an effect"), select);
  }

  private try(name: string, given: Record<string, number>): void {
    const entry = this.catalogue.find((e) => e.name === name);
    if (!entry) return;
    const values: Record<string, number> = {};
    const place = h("div", { class: "plot" });
    const sliders = entry.parameters.filter((p) => p.default === null || p.name in given).map((p) => this.slider(p, given[p.name] ?? p.start, (value) => { values[p.name] = value; later(); }));
    entry.parameters.forEach((p) => { if (p.name in given) values[p.name] = given[p.name]; });
    let timer = 0;
    const later = () => { clearTimeout(timer); timer = window.setTimeout(() => void this.effect(name, values, place), 150); };
    const other = h("select", { "aria-label": "Effect to try", onchange: () => this.try(other.value, {}) }, this.catalogue.filter((e) => e.name !== "expression").map((e) => h("option", { value: e.name, selected: e.name === name }, e.name)));
    fill(this.trial, h("h3", {}, "What it would do to the curves"), h("div", { class: "row" }, other, h("code", {}, entry.equation)), h("p", { class: "quiet" }, entry.shows, entry.experiment ? ` Made visible by: ${entry.experiment}` : ""), sliders, place,
      h("button", { onclick: (e: Event) => void this.add(name, values, e.currentTarget as HTMLButtonElement) }, `Add ${name} with these values`));
    void this.effect(name, values, place);
  }

  private slider(p: Parameter, start: number, set: (value: number) => void): HTMLElement {
    const [low, high] = p.prior;
    const scale = p.log_scale && low > 0;
    const ends = scale ? [Math.log10(low), Math.log10(high)] : p.sign === "either" ? [-high, high] : [low, high];
    const shown = h("output", {}, quantity(start, p.unit));
    const input = h("input", { type: "range", min: String(ends[0]), max: String(ends[1]), step: "any", "aria-label": p.unit === "1" ? p.name : `${p.name}, ${p.unit}`, oninput: () => {
      const value = scale ? 10 ** Number(input.value) : Number(input.value);
      shown.textContent = quantity(value, p.unit);
      set(value);
    } });
    input.value = String(scale ? Math.log10(Math.max(start, 1e-30)) : start);
    return h("label", { class: "slider", title: p.about }, h("span", {}, p.name), input, shown);
  }

  private async effect(name: string, values: Record<string, number>, place: HTMLElement): Promise<void> {
    const [plain, added] = await Promise.all([trying(() => post<Expected[]>("dry-run", {})), trying(() => post<Expected[]>("dry-run", { effect: { name, ...values } }))]);
    if (!plain || !added) return;
    const frequencies = [...new Set([...plain, ...this.steps].map((e) => e.frequency_hz))].sort((a, b) => a - b);
    const of = (list: { frequency_hz: number; direction: string; a_max_m_s2: number }[]) => { const map = new Map(list.filter((e) => e.direction === "forward").map((e) => [e.frequency_hz, e.a_max_m_s2])); return frequencies.map((f) => map.get(f) ?? null); };
    fill(place);
    new Plot(place, 200, [
      { label: "measured", colour: ink("measured"), width: 0, points: true }, { label: "model", colour: ink("model"), dash: [6, 4] }, { label: `with ${name}`, colour: ink("residual"), width: 2.2 },
    ], { x: "frequency Hz (forward)", y: "A max  m/s²", zero: true }).set([frequencies, of(this.steps), of(plain), of(added)]);
  }

  private async add(name: string, parameters: Record<string, number>, button: HTMLButtonElement, expression?: string): Promise<void> {
    const done = await trying(() => post<SetUp>("setup/model/effects", { name, ...parameters, ...(expression ? { expression } : {}) }), button);
    if (!done) return;
    tell(`${name} is added to the onboard model; run again and watch the error fall`);
    this.changed();
    await this.refresh();
  }

  private async takeBack(button: HTMLButtonElement): Promise<void> {
    if (await trying(() => post("setup/model/undo"), button)) {
      tell("The last change of the model is taken back");
      this.changed();
    }
    await this.refresh();
  }

  private take(test: NonNullable<Diagnosis["next_test"]>): void {
    const s = test.sweep;
    if (!s) return;
    const mount = s.without_bumpers ? " Take the bumpers off and set the case to B0." : s.total_gap_m ? ` Set the gap to ${short(1e3 * s.total_gap_m)} mm and the case to match.` : "";
    this.load({ start_hz: s.start_hz, stop_hz: s.stop_hz, step_hz: s.step_hz, frequencies_hz: undefined, dwell_hz: undefined, cycles: s.cycles, acceleration_g: s.acceleration_g }, `${test.title}.${mount}`);
  }
}
