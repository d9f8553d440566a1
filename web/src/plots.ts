// Plots: uPlot with the page's colours, small x-y plots on a canvas of their own, maps of cells.

import uPlot from "uplot";
import { h, ink, dark } from "./ui";

export interface Series { label: string; colour: string; width?: number; dash?: number[]; points?: boolean; scale?: string; gaps?: boolean }

/** A plot over a common axis that follows the width of its place. */
export class Plot {
  chart: uPlot;
  constructor(
    private place: HTMLElement,
    private height: number,
    series: Series[],
    options: {
      x: string; y: string; sync?: string; legend?: boolean; log?: boolean; live?: boolean;
      zero?: boolean; range?: () => [number, number]; click?: (x: number) => void; y2?: string; time?: boolean;
    },
  ) {
    const text = ink("quiet");
    const grid = { stroke: ink("grid"), width: 1 };
    const font = "11px system-ui, sans-serif";
    const axis = { stroke: text, grid, ticks: grid, font, labelFont: font, labelSize: 16 };
    const scales: uPlot.Scales = { x: { time: false, ...(options.range ? { range: options.range } : {}) }, y: options.log ? { distr: 3 } : options.zero ? { range: (_, __, high) => [0, 1.08 * (high || 1)] } : {} };
    const axes: uPlot.Axis[] = [
      { ...axis, label: options.x, size: 30 },
      { ...axis, label: options.y, size: 52, space: 22 },
    ];
    if (options.y2) {
      scales.y2 = {};
      axes.push({ ...axis, label: options.y2, scale: "y2", side: 1, size: 46, grid: { show: false } });
    }
    this.chart = new uPlot(
      {
        width: this.width, height, scales, axes,
        legend: { show: options.legend !== false, live: !options.live || true },
        cursor: { sync: options.sync ? { key: options.sync } : undefined, drag: { x: !options.live, y: false }, points: { show: !options.live } },
        series: [
          { label: options.x || "t", value: (_, v) => (v === null || v === undefined ? "–" : Number(v.toFixed(3)).toString()) },
          ...series.map((s): uPlot.Series => ({
            label: s.label, stroke: s.colour, width: s.width ?? 1.5, dash: s.dash, scale: s.scale ?? "y",
            points: { show: s.points ?? false, size: 5 }, spanGaps: !s.gaps,
            value: (_, v) => (v === null || v === undefined ? "–" : Number(v.toPrecision(4)).toString()),
          })),
        ],
        hooks: options.click
          ? { ready: [(u) => u.over.addEventListener("click", () => { const x = u.cursor.left; if (x !== undefined && x >= 0) options.click?.(u.posToVal(x, "x")); })] }
          : {},
      },
      [[0], ...series.map(() => [null])] as uPlot.AlignedData,
      place,
    );
    new ResizeObserver(() => this.fit()).observe(place);
  }
  private get width(): number { return Math.max(200, Math.floor(this.place.clientWidth)); }
  fit(): void {
    if (this.place.clientWidth > 0) this.chart.setSize({ width: this.width, height: this.height });
  }
  set(data: (ArrayLike<number | null>)[], keepScale = false): void {
    this.chart.setData(data as unknown as uPlot.AlignedData, !keepScale);
  }
}

/** Smallest and largest of some values, widened a little. */
function reach(parts: ArrayLike<number>[]): [number, number] {
  let low = Infinity, high = -Infinity;
  for (const values of parts) for (let i = 0; i < values.length; i++) {
    const v = values[i];
    if (v < low) low = v;
    if (v > high) high = v;
  }
  if (!(high > low)) return [-1, 1];
  const more = 0.06 * (high - low);
  return [low - more, high + more];
}

export interface Trace { x: ArrayLike<number>; y: ArrayLike<number>; colour: string; width?: number; dash?: number[] }

/** An x-y plot: loops A(D), phase portraits. */
export class XY {
  canvas: HTMLCanvasElement;
  readout: HTMLElement;
  element: HTMLElement;
  constructor(label: string, private xLabel: string, private yLabel: string) {
    this.canvas = h("canvas", { class: "xy", role: "img", "aria-label": label });
    this.readout = h("span", { class: "quiet" });
    this.element = h("figure", { class: "xyplot" }, h("figcaption", {}, label, " ", this.readout), this.canvas);
  }
  draw(traces: Trace[]): void {
    const canvas = this.canvas;
    const scale = devicePixelRatio || 1;
    const width = canvas.clientWidth, height = canvas.clientHeight;
    if (width === 0 || height === 0) return;
    if (canvas.width !== Math.round(width * scale) || canvas.height !== Math.round(height * scale)) {
      canvas.width = Math.round(width * scale);
      canvas.height = Math.round(height * scale);
    }
    const g = canvas.getContext("2d");
    if (!g) return;
    g.setTransform(scale, 0, 0, scale, 0, 0);
    g.clearRect(0, 0, width, height);
    const [x0, x1] = reach(traces.map((t) => t.x)), [y0, y1] = reach(traces.map((t) => t.y));
    const left = 40, bottom = 26, top = 18, right = 8;
    const px = (x: number) => left + ((x - x0) / (x1 - x0)) * (width - left - right);
    const py = (y: number) => height - bottom - ((y - y0) / (y1 - y0)) * (height - bottom - top);
    g.font = "10px system-ui, sans-serif";
    g.fillStyle = ink("quiet");
    g.strokeStyle = ink("grid");
    g.lineWidth = 1;
    for (const x of ticks(x0, x1)) {
      g.beginPath(); g.moveTo(px(x), top); g.lineTo(px(x), height - bottom); g.stroke();
      g.textAlign = "center"; g.fillText(String(x), px(x), height - bottom + 11);
    }
    for (const y of ticks(y0, y1)) {
      g.beginPath(); g.moveTo(left, py(y)); g.lineTo(width - right, py(y)); g.stroke();
      g.textAlign = "right"; g.fillText(String(y), left - 4, py(y) + 3);
    }
    g.textAlign = "right";
    g.fillText(this.xLabel, width - right, height - 3);
    g.textAlign = "left";
    g.fillText(this.yLabel, 2, 10);
    for (const trace of traces) {
      g.strokeStyle = trace.colour;
      g.lineWidth = trace.width ?? 1.5;
      g.setLineDash(trace.dash ?? []);
      g.beginPath();
      for (let i = 0; i < trace.x.length; i++) g.lineTo(px(trace.x[i]), py(trace.y[i]));
      g.stroke();
    }
    g.setLineDash([]);
  }
}

function ticks(low: number, high: number): number[] {
  // Of a range to both sides of zero, three at least.
  const raw = (high - low) / 5;
  const size = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map((k) => k * size).find((s) => s >= raw) ?? raw;
  const out = [];
  for (let t = Math.ceil(low / step) * step; t <= high; t += step) out.push(Number(t.toPrecision(6)));
  return out;
}

/** A colour between two ends of a scale that colour-blind readers can follow (dark blue to yellow). */
export function heat(share: number): string {
  const t = Math.max(0, Math.min(1, share));
  const stops = [[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]];
  const at = t * (stops.length - 1), i = Math.min(stops.length - 2, Math.floor(at)), f = at - i;
  const mix = stops[i].map((v, k) => Math.round(v + f * (stops[i + 1][k] - v)));
  return `rgb(${mix.join(",")})`;
}

/** Blue below zero, vermilion above, the page's ground at zero. */
export function sign(share: number): string {
  const t = Math.max(-1, Math.min(1, share));
  const ground = dark() ? [38, 44, 52] : [247, 247, 247];
  const end = t < 0 ? [0, 114, 178] : [213, 94, 0];
  return `rgb(${ground.map((v, k) => Math.round(v + Math.abs(t) * (end[k] - v))).join(",")})`;
}

export interface Cell { value: number | null; title: string; pick?: () => void }

/** A map of cells, each reachable by pointer and keyboard. */
export function cells(
  rows: { label: string; cells: Cell[] }[], columns: string[], colour: (v: number) => string, caption: string,
): HTMLElement {
  const body = rows.map((row) =>
    h("tr", {}, h("th", { scope: "row" }, row.label), row.cells.map((cell) => {
      const td = h("td", { title: cell.title });
      if (cell.value !== null) td.style.background = colour(cell.value);
      if (cell.pick) {
        const button = h("button", { class: "cell", "aria-label": cell.title, onclick: cell.pick });
        td.append(button);
      }
      return td;
    })));
  return h("div", { class: "scroll" }, h("table", { class: "map" }, h("caption", {}, caption),
    h("thead", {}, h("tr", {}, h("th", {}), columns.map((c) => h("th", { scope: "col" }, c)))), h("tbody", {}, body)));
}
