// Where the model fails: error by frequency and phase of the cycle, by regime, by direction; a click on a cell
// shows those cycles.

import { get, post, run } from "./api";
import { Plot, XY, cells, heat } from "./plots";
import type { Cycles, Failure, RunShort, Slice, Status } from "./types";
import { fill, h, ink, percent, short, trying } from "./ui";

export class Fails {
  element: HTMLElement;
  private select = h("select", { "aria-label": "Run", onchange: () => void this.compare() });
  private which = h("select", { "aria-label": "Quantity", onchange: () => this.draw() }, h("option", { value: "a" }, "acceleration A"), h("option", { value: "d" }, "displacement D"));
  private against = h("select", { "aria-label": "Model", onchange: () => void this.compare() }, h("option", { value: "run" }, "model of the run"), h("option", { value: "now" }, "model as set up now"));
  private sentence = h("p", { class: "sentence", role: "status" });
  private numbers = h("div", { class: "numbers" });
  private map = h("div", {});
  private bars = h("div", { class: "bars" });
  private cycles = h("div", {});
  private failure: Failure | undefined;

  constructor() {
    this.element = h("div", { class: "two" },
      h("section", { class: "panel grow", "aria-label": "Where the model fails" },
        h("div", { class: "row" }, h("h2", {}, "Where it fails"), this.select, this.against, this.which), this.sentence, this.numbers, this.map, this.cycles),
      h("section", { class: "panel narrow", "aria-label": "By regime and direction" }, this.bars));
  }

  async show(status: Status | undefined): Promise<void> {
    const runs = (await trying(() => get<RunShort[]>("runs?limit=60"))) ?? [];
    const wanted = this.select.value || status?.ended?.id || "";
    const whole = runs.filter((r) => r.state !== "running" && r.state !== "unreadable");
    fill(this.select, whole.map((r) => h("option", { value: r.id, selected: r.id === wanted }, `${r.name}, ${r.started_utc.slice(5, 16).replace("T", " ")}`)));
    if (status?.ended && whole.some((r) => r.id === status.ended?.id)) this.select.value = status.ended.id;
    if (whole.length === 0) fill(this.sentence, "No run yet: run a sweep on the bench first.");
    else await this.compare();
  }

  private async compare(): Promise<void> {
    fill(this.sentence, "Comparing…");
    fill(this.cycles);
    const failure = await trying(() => post<Failure>(`${run(this.select.value)}/compare`, { as_set_up: this.against.value === "now" }));
    this.failure = failure;
    if (failure) this.draw();
    else fill(this.sentence, "This run cannot be compared.");
  }

  private draw(): void {
    const failure = this.failure;
    if (!failure) return;
    const d = this.which.value === "d";
    const { comparison, map } = failure;
    const e = comparison.error;
    fill(this.sentence, comparison.sentence);
    const over = (x: number | null, floor: number | null) => (x !== null && floor ? ` · ${short(x / floor)} times the noise floor of ${percent(floor, 2)}` : "");
    fill(this.numbers, h("span", {}, "A ", h("b", {}, percent(e.nrmse_a, 2)), over(e.nrmse_a, e.noise_floor_a)), h("span", {}, "D ", h("b", {}, percent(e.nrmse_d, 2)), over(e.nrmse_d, e.noise_floor_d)),
      comparison.quality.map((q) => h("span", { class: "bad" }, q.text)));
    const values = d ? map.nrmse_d : map.nrmse_a;
    const top = Math.max(1e-9, ...values.flat().map((v) => v ?? 0));
    const columns = Array.from({ length: map.bins }, (_, i) => (i % 3 === 0 ? `${Math.round((360 * i) / map.bins)}°` : ""));
    const rows = map.steps.map((step, i) => ({
      label: `${short(step.frequency_hz)} ${step.direction === "backward" ? "↓" : "↑"}`,
      cells: values[i].map((value, bin) => {
        const from = Math.round((360 * bin) / map.bins), to = Math.round((360 * (bin + 1)) / map.bins);
        return {
          value, title: `${short(step.frequency_hz)} Hz ${step.direction ?? ""}, ${from} to ${to} degrees: ${percent(value)}`,
          pick: () => void this.pick(step.index, from, to),
        };
      }),
    }));
    fill(this.map, cells(rows, columns, (v) => heat(v / top), `Error of ${d ? "D" : "A"} by frequency (Hz, ↑ forward, ↓ backward) and phase of the table's cycle; yellow is ${percent(top)}. Click a cell to see its cycles.`));
    const bars = (title: string, slices: Slice[]) => {
      const shares = slices.map((s) => (d ? s.share_of_misfit_d : s.share_of_misfit_a) ?? 0);
      return slices.length > 0 && [h("h3", {}, title), h("table", { class: "small bars" }, h("thead", {}, h("tr", {}, ["", "error", "of all", ""].map((t) => h("th", {}, t)))),
        h("tbody", {}, slices.map((s, i) => h("tr", {}, h("td", {}, s.name), h("td", {}, percent(d ? s.nrmse_d : s.nrmse_a)), h("td", {}, percent(shares[i], 0)),
          h("td", {}, h("meter", { min: 0, max: 1, value: shares[i], "aria-label": `share of ${s.name}` }))))))];
    };
    fill(this.bars, bars("By regime", comparison.regimes) || null, bars("By direction", comparison.directions) || null, bars("By amplitude", comparison.amplitudes) || null);
  }

  private async pick(step: number, from: number, to: number): Promise<void> {
    const cycles = await trying(() => get<Cycles>(`${run(this.select.value)}/cycles?step=${step}&cycles=3`));
    if (!cycles) return;
    const places = [h("div", { class: "plot" }), h("div", { class: "plot" })];
    const loop = new XY("Hysteresis loop A(D)", "D mm", "A m/s²");
    fill(this.cycles, h("h3", {}, `Last three cycles at ${short(cycles.frequency_hz)} Hz; marked: ${from}° to ${to}°`), places, h("div", { class: "row" }, loop.element));
    this.cycles.scrollIntoView({ behavior: "smooth", block: "nearest" });
    const marked = (values: number[]) => values.map((v, i) => (cycles.phase_deg[i] >= from && cycles.phase_deg[i] < to ? v : null));
    const series = (name: string) => [{ label: name, colour: ink("measured") }, { label: `model ${name}`, colour: ink("model"), dash: [6, 3] }, { label: "the cell", colour: ink("other"), width: 4, gaps: true }];
    const mm = (values: number[]) => values.map((v) => 1e3 * v);
    new Plot(places[0], 150, series("A"), { x: "s", y: "A  m/s²", sync: "cycles" }).set([cycles.time_s, cycles.mass_acceleration_m_s2, cycles.model_acceleration_m_s2, marked(cycles.mass_acceleration_m_s2)]);
    new Plot(places[1], 150, series("D"), { x: "s", y: "D  mm", sync: "cycles" }).set([cycles.time_s, mm(cycles.relative_displacement_m), mm(cycles.model_displacement_m), marked(mm(cycles.relative_displacement_m))]);
    loop.draw([{ x: mm(cycles.relative_displacement_m), y: cycles.mass_acceleration_m_s2, colour: ink("measured") },
      { x: mm(cycles.model_displacement_m), y: cycles.model_acceleration_m_s2, colour: ink("model"), dash: [5, 3] }]);
  }
}
