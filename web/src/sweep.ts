// The sweep: edit it, see what it asks of the table, let the onboard model say what to expect.

import { get, post, put } from "./api";
import { Plot } from "./plots";
import type { Asks, Expected, SetUp, Status, Sweep } from "./types";
import { duration, fill, h, ink, percent, short, tell, trying } from "./ui";

export class SweepScreen {
  element: HTMLElement;
  private form = h("form", { class: "form", onsubmit: (e: Event) => { e.preventDefault(); void this.save(); } });
  private verdict = h("div", { class: "verdict", role: "status" });
  private limits = h("div", {});
  private where = h("div", { class: "plot" });
  private expected = h("div", {});
  private setup: SetUp | undefined;
  private fields: Record<string, HTMLInputElement | HTMLSelectElement> = {};
  private plot: Plot | undefined;
  private timer = 0;

  constructor(private changed: () => void) {
    this.element = h("div", { class: "two" },
      h("section", { class: "panel", "aria-label": "The sweep" }, h("h2", {}, "Sweep"), this.form),
      h("section", { class: "panel grow", "aria-label": "What it asks of the table" }, h("h2", {}, "Against the table's limits"), this.verdict, this.limits,
        h("h3", {}, "Share of each limit, step by step"), this.where,
        h("h3", {}, "Dry run: what the onboard model expects"),
        h("button", { onclick: (e: Event) => void this.dryRun(e.currentTarget as HTMLButtonElement) }, "Dry run"), this.expected));
  }

  async show(_: Status | undefined, wanted?: Partial<Sweep>): Promise<void> {
    const setup = await trying(() => get<SetUp>("setup"));
    if (!setup) return;
    this.setup = setup;
    this.build(wanted ? { ...setup.sweep, ...wanted } : setup.sweep);
    await this.preview();
  }

  private build(s: Sweep): void {
    const listed = s.frequencies_hz !== undefined || s.dwell_hz !== undefined;
    const number = (key: string, label: string, value: number | undefined, step: string, unit: string) => {
      const input = h("input", { type: "number", step, value: value === undefined ? "" : String(value), id: `sweep-${key}`, oninput: () => this.later() });
      this.fields[key] = input;
      return h("label", { for: `sweep-${key}` }, h("span", {}, label), input, h("span", { class: "quiet" }, unit));
    };
    const choice = (key: string, label: string, value: string, values: string[]) => {
      const select = h("select", { id: `sweep-${key}`, onchange: () => this.later() }, values.map((v) => h("option", { value: v, selected: v === value }, v)));
      this.fields[key] = select;
      return h("label", { for: `sweep-${key}` }, h("span", {}, label), select);
    };
    this.fields = {};
    const text = h("input", { type: "text", id: "sweep-list", value: (s.frequencies_hz ?? (s.dwell_hz ? [s.dwell_hz] : [])).join(" "), placeholder: "1.0 1.2 1.4", oninput: () => this.later() });
    this.fields.list = text;
    const setCase = h("input", { type: "text", id: "sweep-case", value: this.setup?.case ?? "", placeholder: "B1-G2-0.05", pattern: "B0-[0-9.]+|B[1-4]-G[1-4]-[0-9.]+" });
    fill(this.form,
      h("label", { for: "sweep-case" }, h("span", {}, "Case"), setCase,
        h("button", { type: "button", onclick: (e: Event) => void this.setCase(setCase.value, e.currentTarget as HTMLButtonElement) }, "Set")),
      h("p", { class: "quiet" }, "Bumper, gap and A_G as they are mounted on the rig."),
      number("start_hz", "From", listed ? undefined : s.start_hz, "0.05", "Hz"),
      number("stop_hz", "To", listed ? undefined : s.stop_hz, "0.05", "Hz"),
      number("step_hz", "Step", listed ? undefined : s.step_hz, "0.01", "Hz"),
      h("label", { for: "sweep-list" }, h("span", {}, "or a list"), text, h("span", { class: "quiet" }, "Hz")),
      number("cycles", "Counted cycles", s.cycles, "1", "a step"),
      choice("direction", "Direction", s.direction, ["forward-backward", "forward", "backward"]),
      number("acceleration_g", "A_G", s.acceleration_g, "0.005", "g"),
      number("transition_cycles", "Transition", s.transition_cycles, "1", "cycles"),
      number("ramp_cycles", "Ramps", s.ramp_cycles, "1", "cycles"),
      h("div", { class: "row" }, h("button", { class: "loud", type: "submit" }, "Set this sweep"),
        h("button", { type: "button", onclick: () => void this.show(undefined) }, "As set up")));
  }

  private read(): Sweep {
    const number = (key: string) => { const v = this.fields[key]?.value ?? ""; return v === "" ? undefined : Number(v); };
    const list = (this.fields.list?.value ?? "").split(/[\s,;]+/).filter(Boolean).map(Number);
    const sweep: Sweep = {
      cycles: number("cycles") ?? 10, direction: this.fields.direction?.value ?? "forward-backward",
      acceleration_g: number("acceleration_g") ?? 0.05, transition: "smooth",
      transition_cycles: number("transition_cycles") ?? 1, ramp_cycles: number("ramp_cycles") ?? 2,
    };
    if (list.length > 0) sweep.frequencies_hz = list;
    else Object.assign(sweep, { start_hz: number("start_hz"), stop_hz: number("stop_hz"), step_hz: number("step_hz") });
    return sweep;
  }

  private later(): void {
    clearTimeout(this.timer);
    this.timer = window.setTimeout(() => void this.preview(), 250);
  }

  private async preview(): Promise<void> {
    let asks: Asks;
    try {
      asks = await post<Asks>("preview", { sweep: this.read() });
    } catch (error) {
      fill(this.verdict, h("b", { class: "bad" }, "✗ "), error instanceof Error ? error.message : String(error));
      fill(this.limits);
      return;
    }
    fill(this.verdict, asks.fits ? [h("b", { class: "good" }, "✓ within the limits"), ` · ${asks.steps} steps, ${duration(asks.duration_s)} from rest to rest`]
      : [h("b", { class: "bad" }, "✗ beyond the table: "), asks.refused ?? ""]);
    fill(this.limits, h("table", { class: "small" }, h("thead", {}, h("tr", {}, ["", "asked", "allowed", "use", "", "where"].map((t) => h("th", {}, t)))),
      h("tbody", {}, asks.uses.map((use) => h("tr", { class: use.used > 1 ? "bad" : "" }, h("td", {}, use.quantity), h("td", {}, short(use.asked)), h("td", {}, `${short(use.allowed)} ${use.unit}`),
        h("td", {}, percent(use.used, 0)), h("td", {}, h("meter", { min: 0, max: 1, high: 0.9, value: Math.min(1, use.used), "aria-label": use.quantity })), h("td", { class: "quiet" }, `${short(use.frequency_hz)} Hz, ${use.place}`))))));
    const steps = asks.rows.filter((row) => row.place === "step");
    const allowed = (name: string) => { const use = asks.uses.find((u) => u.quantity === name); return use ? use.allowed : 1; };
    this.plot ??= new Plot(this.where, 170, [
      { label: "displacement %", colour: ink("b1") }, { label: "velocity %", colour: ink("b2"), dash: [6, 3] },
      { label: "acceleration %", colour: ink("b4"), dash: [2, 3] }, { label: "force %", colour: ink("b3"), dash: [10, 3, 2, 3] },
    ], { x: "step", y: "% of the limit" });
    this.plot.set([steps.map((s) => s.index + 1), steps.map((s) => 1e5 * s.displacement_m / allowed("displacement")),
      steps.map((s) => 1e5 * s.velocity_m_s / allowed("velocity")), steps.map((s) => 100 * s.acceleration_m_s2 / allowed("acceleration")),
      steps.map((s) => 100 * s.force_n / allowed("force"))]);
    this.plot.fit();
  }

  private async dryRun(button: HTMLButtonElement): Promise<void> {
    const expected = await trying(() => post<Expected[]>("dry-run", { sweep: this.read() }), button);
    if (!expected) return;
    const worst = expected.reduce((a, b) => (b.a_max_m_s2 > a.a_max_m_s2 ? b : a), expected[0]);
    const place = h("div", { class: "plot" });
    fill(this.expected, h("p", {}, `Largest A: ${short(worst.a_max_m_s2)} m/s² at ${short(worst.frequency_hz)} Hz ${worst.direction}; excursion there ${short(1e3 * worst.excursion_m)} mm.`), place);
    const half = (direction: string) => expected.filter((e) => e.direction === direction);
    const frequencies = [...new Set(expected.map((e) => e.frequency_hz))].sort((a, b) => a - b);
    const of = (direction: string) => { const map = new Map(half(direction).map((e) => [e.frequency_hz, e.a_max_m_s2])); return frequencies.map((f) => map.get(f) ?? null); };
    new Plot(place, 180, [{ label: "forward", colour: ink("forward"), width: 2.5, dash: [7, 4] }, { label: "backward", colour: ink("backward"), width: 1.2, dash: [7, 4] }], { x: "Hz", y: "A  m/s²" })
      .set([frequencies, of("forward"), of("backward")]);
  }

  private async setCase(name: string, button: HTMLButtonElement): Promise<void> {
    if (await trying(() => put("setup/case", { case: name.trim() }), button)) {
      tell(`Set up for ${name.trim()}`);
      this.changed();
      await this.show(undefined);
    }
  }

  private async save(): Promise<void> {
    if (await trying(() => put("setup/sweep", this.read()))) {
      tell("The sweep is set");
      this.changed();
    }
  }
}
