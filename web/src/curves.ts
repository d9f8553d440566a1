// Pseudo-resonance curves: peaks against frequency as they grow, both directions, the model over them, earlier
// runs beneath in the paper's legend.

import { get, run } from "./api";
import { Plot, type Series } from "./plots";
import type { RunShort, Status, Step } from "./types";
import { fill, h, ink, legend, trying } from "./ui";

type Curve = (number | null)[];

export class Curves {
  element: HTMLElement;
  steps: Step[] = [];
  beneath = new Set<string>();
  private id = "";
  private title = h("span", { class: "quiet" });
  private plots = h("div", {});
  private choice = h("div", { class: "choice" });
  private kept = new Map<string, Step[]>();
  private runs: RunShort[] = [];
  private charts: Plot[] = [];
  private made = "";

  constructor() {
    this.element = h("div", { class: "two" },
      h("section", { class: "panel grow", "aria-label": "Pseudo-resonance curves" },
        h("div", { class: "row" }, h("h2", {}, "Pseudo-resonance curves"), this.title,
          h("span", { class: "spring-right" }), h("span", { class: "key forward" }, "forward"), h("span", { class: "key backward" }, "backward"),
          h("span", { class: "quiet" }, "solid measured, dashed model")),
        this.plots),
      h("section", { class: "panel narrow", "aria-label": "Earlier runs" }, h("h2", {}, "Lay beneath"), this.choice));
  }

  /** A step has just ended. */
  add(step: Step): void {
    if (!this.steps.some((s) => s.index === step.index)) this.steps.push(step);
    if (this.element.isConnected) this.draw();
  }

  /** Takes the run that goes on or the last one. */
  async show(status: Status | undefined): Promise<void> {
    const id = status?.run?.id ?? status?.ended?.id ?? "";
    this.id = id;
    this.title.textContent = id;
    const steps = await trying(() => (status?.run ? get<Step[]>("session/steps") : id ? get<Step[]>(`${run(id)}/steps`) : Promise.resolve([])));
    if (steps) this.steps = steps;
    this.runs = (await trying(() => get<RunShort[]>("runs?limit=60"))) ?? [];
    fill(this.choice, this.runs.filter((r) => r.id !== id && r.state !== "unreadable" && r.state !== "running").map((r) => {
      const style = legend(r.name);
      const box = h("input", { type: "checkbox", checked: this.beneath.has(r.id), onchange: () => void this.toggle(r.id, box.checked) });
      const key = h("span", { "aria-hidden": "true" }, style.marker);
      key.style.color = style.colour;
      return h("label", {}, box, " ", key, ` ${r.name} `, h("span", { class: "quiet" }, `${r.started_utc.slice(5, 16).replace("T", " ")} ${r.state}`));
    }));
    for (const id of this.beneath) await this.load(id);
    this.made = "";
    this.draw();
  }

  private async load(id: string): Promise<void> {
    if (this.kept.has(id)) return;
    const steps = await trying(() => get<Step[]>(`${run(id)}/steps`));
    if (steps) this.kept.set(id, steps);
  }

  private async toggle(id: string, on: boolean): Promise<void> {
    if (on) this.beneath.add(id);
    else this.beneath.delete(id);
    await this.load(id);
    this.draw();
  }

  private draw(): void {
    const earlier = [...this.beneath].map((id) => ({ run: this.runs.find((r) => r.id === id), steps: this.kept.get(id) ?? [] }));
    const all = [...this.steps, ...earlier.flatMap((e) => e.steps)];
    const frequencies = [...new Set(all.map((s) => s.frequency_hz))].sort((a, b) => a - b);
    const curve = (steps: Step[], direction: string, of: (s: Step) => number): Curve => {
      const found = new Map(steps.filter((s) => s.direction === direction).map((s) => [s.frequency_hz, of(s)]));
      return frequencies.map((f) => found.get(f) ?? null);
    };
    const key = [...this.beneath].join();
    if (key !== this.made || this.charts.length === 0) {
      this.made = key;
      const forward = ink("forward"), backward = ink("backward");
      const series: Series[] = [
        ...earlier.flatMap((e): Series[] => {
          const style = legend(e.run?.name ?? null);
          const base = { colour: style.colour, dash: style.dash };
          return [{ ...base, label: `${style.marker} ${e.run?.name ?? "?"} fwd`, width: 1.8 }, { ...base, label: "bwd", width: 0.9 }];
        }),
        { label: "forward", colour: forward, width: 2.6, points: true }, { label: "backward", colour: backward, width: 1.3, points: true },
        { label: "model forward", colour: forward, width: 2, dash: [7, 4] }, { label: "model backward", colour: backward, width: 1, dash: [7, 4] },
      ];
      const places = [h("div", { class: "plot" }), h("div", { class: "plot" })];
      fill(this.plots, places);
      this.charts = [
        new Plot(places[0], 230, series, { x: "frequency Hz", y: "A max  m/s²", sync: "curves", zero: true }),
        new Plot(places[1], 230, series, { x: "frequency Hz", y: "excursion  mm", sync: "curves", zero: true }),
      ];
    }
    const data = (measured: (s: Step) => number, model: (s: Step) => number) => [
      frequencies.length ? frequencies : [0],
      ...earlier.flatMap((e) => [curve(e.steps, "forward", measured), curve(e.steps, "backward", measured)]),
      curve(this.steps, "forward", measured), curve(this.steps, "backward", measured),
      curve(this.steps, "forward", model), curve(this.steps, "backward", model),
    ];
    this.charts[0].set(data((s) => s.a_max_m_s2, (s) => s.model_a_max_m_s2));
    this.charts[1].set(data((s) => 1e3 * s.excursion_m, (s) => 1e3 * s.model_excursion_m));
    this.charts.forEach((chart) => chart.fit());
  }

  /** A run has begun: its curves begin anew. */
  begin(id: string): void {
    if (id === this.id) return;
    this.id = id;
    this.steps = [];
    this.title.textContent = id;
    if (this.element.isConnected) this.draw();
  }
}
