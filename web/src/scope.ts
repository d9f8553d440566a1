// The live scope: acceleration and displacement, measured and model, and their difference; pause, cursors,
// windows. Drawn in step with the screen.

import { Ch, type Live } from "./live";
import { Plot, XY } from "./plots";
import { h, ink } from "./ui";

/** Slope over 25 samples by least squares (Savitzky and Golay 1964), which noise of the laser needs. */
function slope(values: Float64Array, rate: number): Float64Array {
  const half = 12, out = new Float64Array(values.length);
  const norm = (half * (half + 1) * (2 * half + 1)) / 3 / rate;
  for (let i = half; i < values.length - half; i++) {
    let sum = 0;
    for (let k = 1; k <= half; k++) sum += k * (values[i + k] - values[i - k]);
    out[i] = sum / norm;
  }
  return out.subarray(half, values.length - half);
}

export class Scope {
  element: HTMLElement;
  loop = new XY("Hysteresis loop A(D)", "D mm", "A m/s²");
  portrait = new XY("Phase portrait D′(D)", "D mm", "D′ mm/s");
  paused = false;
  /** Times at which frames were drawn, for the rate that is shown. */
  drawn: number[] = [];
  private plots: Plot[] = [];
  private frozen = 0;
  private pauseButton: HTMLButtonElement;
  private seen = -1;
  private tick = 0;

  constructor(private live: Live) {
    const windows = [2, 5, 10, 30, 60, 300];
    const select = h("select", { "aria-label": "Window", onchange: () => live.window(Number(select.value)) },
      windows.map((s) => h("option", { value: String(s), selected: s === live.windowS }, s < 60 ? `${s} s` : `${s / 60} min`)));
    this.pauseButton = h("button", { onclick: () => this.pause(!this.paused), title: "P" }, "Pause");
    this.element = h("section", { class: "scope", "aria-label": "Live scope" },
      h("div", { class: "row" }, h("h2", {}, "Live"), h("span", { class: "key measured" }, "measured"),
        h("span", { class: "key model" }, "model"), h("span", { class: "key residual" }, "difference"),
        h("span", { class: "spring-right" }), select, this.pauseButton));
  }

  /** Makes the plots once their place has a size. */
  attach(): void {
    if (this.plots.length > 0) return;
    const live = this.live;
    const range = (): [number, number] => {
      const now = this.paused ? this.frozen : live.past.now;
      return [Math.max(0, now - live.windowS), Math.max(now, live.windowS)];
    };
    const measured = ink("measured"), model = ink("model"), residual = ink("residual"), other = ink("other");
    const place = () => this.element.appendChild(h("div", { class: "plot" }));
    const options = { x: "", sync: "scope", live: true, range, legend: true };
    this.plots = [
      new Plot(place(), 172, [{ label: "A", colour: measured }, { label: "model A", colour: model, width: 1 }], { ...options, y: "A  m/s²" }),
      new Plot(place(), 172, [{ label: "D", colour: measured }, { label: "model D", colour: model, width: 1 }], { ...options, y: "D  mm" }),
      new Plot(place(), 168, [{ label: "A − model", colour: residual, width: 1 }, { label: "D − model", colour: other, width: 1, scale: "y2" }],
        { ...options, x: "s", y: "ΔA  m/s²", y2: "ΔD  mm" }),
    ];
  }

  pause(on: boolean): void {
    this.paused = on;
    this.frozen = this.live.past.now;
    this.pauseButton.textContent = on ? "Go on" : "Pause";
    this.pauseButton.setAttribute("aria-pressed", String(on));
  }

  /** Draws what is new; called once a frame of the screen. */
  draw(time: number): void {
    const past = this.live.past;
    if (this.paused || past.length < 2 || this.seen === this.live.frames) return;
    this.seen = this.live.frames;
    this.drawn.push(time);
    if (this.drawn.length > 240) this.drawn.splice(0, 120);
    const t = past.times();
    const a = past.view(Ch.A), ma = past.view(Ch.ModelA), n = t.length;
    const d = past.view(Ch.D), md = past.view(Ch.ModelD);
    const dmm = new Float64Array(n), mdmm = new Float64Array(n), ra = new Float64Array(n), rd = new Float64Array(n);
    for (let i = 0; i < n; i++) {
      dmm[i] = 1e3 * d[i];
      mdmm[i] = 1e3 * md[i];
      ra[i] = a[i] - ma[i];
      rd[i] = dmm[i] - mdmm[i];
    }
    this.plots[0]?.set([t, a, ma]);
    this.plots[1]?.set([t, dmm, mdmm]);
    this.plots[2]?.set([t, ra, rd]);
    // The loops change slowly against the screen: every third frame is enough.
    if (this.live.factor === 1 && this.tick++ % 3 === 0) this.loops(dmm, mdmm, a, ma);
  }

  private loops(d: Float64Array, md: Float64Array, a: Float64Array, ma: Float64Array): void {
    const f = this.live.status?.meters.frequency_hz ?? 1;
    const rate = this.live.status?.setup.sample_rate_hz ?? 2048;
    const n = Math.min(d.length, Math.round((2 * rate) / Math.max(f, 0.3)) + 24);
    const last = (values: Float64Array) => values.subarray(values.length - n);
    const inner = (values: Float64Array) => values.subarray(values.length - n + 12, values.length - 12);
    const measured = ink("measured"), model = ink("model");
    this.loop.draw([
      { x: last(d), y: last(a), colour: measured },
      { x: last(md), y: last(ma), colour: model, dash: [5, 3] },
    ]);
    this.portrait.draw([
      { x: inner(d), y: slope(last(d), rate), colour: measured },
      { x: inner(md), y: slope(last(md), rate), colour: model, dash: [5, 3] },
    ]);
  }
}
