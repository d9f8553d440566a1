// The picture of the rig that moves: table, mass, isolator, bumpers and their gaps, drawn from the newest
// sample, 2.4 pixels a millimetre.

import { Ch, type Past } from "./live";
import type { Status } from "./types";
import { mm } from "./ui";

const NS = "http://www.w3.org/2000/svg";
const SCALE = 2400;
/** Room on either side for the table's way, 62 mm. */
const WAY = 80;

function make(tag: string, attributes: Record<string, string | number>, parent: Element): SVGElement {
  const element = document.createElementNS(NS, tag);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, String(value));
  parent.append(element);
  return element;
}

export class Rig {
  element: SVGElement;
  private table: SVGElement;
  private mass: SVGElement;
  private ghost: SVGElement;
  private spring: SVGElement;
  private right: SVGElement;
  private left: SVGElement;
  private text: SVGElement;

  constructor() {
    const svg = document.createElementNS(NS, "svg");
    this.element = svg;
    for (const [k, v] of Object.entries({ viewBox: `${-WAY} 0 ${480 + 2 * WAY} 178`, class: "rig", role: "img", "aria-label": "The rig as it moves" })) svg.setAttribute(k, v);
    make("line", { x1: -WAY, y1: 168, x2: 480 + WAY, y2: 168, class: "floor" }, svg);
    this.table = make("g", {}, svg);
    make("rect", { x: 70, y: 140, width: 340, height: 20, rx: 2, class: "table" }, this.table);
    for (const x of [100, 370]) make("circle", { cx: x, cy: 164, r: 4, class: "table" }, this.table);
    this.left = make("rect", { x: 0, y: 92, width: 16, height: 26, rx: 3, class: "bumper" }, this.table);
    this.right = make("rect", { x: 0, y: 92, width: 16, height: 26, rx: 3, class: "bumper" }, this.table);
    make("path", { d: "M96 140V80h8v60zM376 140V80h8v60z", class: "stand" }, this.table);
    this.spring = make("path", { class: "spring" }, svg);
    this.ghost = make("rect", { x: 0, y: 60, width: 120, height: 72, rx: 3, class: "ghost" }, svg);
    this.mass = make("g", {}, svg);
    make("rect", { x: -60, y: 60, width: 120, height: 72, rx: 3, class: "mass" }, this.mass);
    for (const x of [-40, 40]) make("circle", { cx: x, cy: 136, r: 4, class: "bearing" }, this.mass);
    make("text", { x: 0, y: 100, "text-anchor": "middle", class: "label" }, this.mass).textContent = "M";
    this.text = make("text", { x: 240, y: 24, "text-anchor": "middle", class: "note" }, svg);
  }

  draw(past: Past, status: Status | undefined): void {
    const x = SCALE * past.last(Ch.TableX), d = SCALE * past.last(Ch.D), model = SCALE * past.last(Ch.ModelD);
    const gap = status?.setup.total_gap_m ?? null;
    const half = gap === null ? 60 : SCALE * gap / 2;
    // The bumpers stand where the mass meets them at half the gap.
    const at = Math.min(60 + half, 136 - 16);
    this.table.setAttribute("transform", `translate(${x.toFixed(1)})`);
    const centre = 240 + x;
    this.mass.setAttribute("transform", `translate(${(centre + d).toFixed(1)})`);
    this.ghost.setAttribute("x", (centre + model - 60).toFixed(1));
    const squeeze = (out: number) => Math.max(0, out - half);
    const place = (bumper: SVGElement, side: number, push: number) => {
      bumper.setAttribute("visibility", gap === null ? "hidden" : "visible");
      const width = Math.max(6, 136 - at - Math.min(push, 20));
      bumper.setAttribute("width", width.toFixed(1));
      bumper.setAttribute("x", (side > 0 ? 376 - width : 104).toFixed(1));
      bumper.classList.toggle("contact", push > 0);
    };
    place(this.right, 1, squeeze(d));
    place(this.left, -1, squeeze(-d));
    const from = 104 + x, to = centre + d - 60;
    let path = `M${from.toFixed(1)} 74`;
    for (let i = 1; i < 12; i++) path += `L${(from + ((to - from) * i) / 12).toFixed(1)} ${i % 2 ? 68 : 80}`;
    this.spring.setAttribute("d", `${path}L${to.toFixed(1)} 74`);
    this.text.textContent = `table ${mm(past.last(Ch.TableX))} mm · D ${mm(past.last(Ch.D))} mm${gap === null ? " · no bumpers" : ` · gap ${mm(gap, 0)} mm`}`;
  }
}
