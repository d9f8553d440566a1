// Recorded runs: list, search, compare, notes, report, export.

import { get, put, run } from "./api";
import type { RunShort } from "./types";
import { fill, h, legend, tell, trying } from "./ui";

export class Runs {
  element: HTMLElement;
  private search = h("input", { type: "search", placeholder: "name, case, state, model, note", "aria-label": "Search", oninput: () => this.later() });
  private table = h("div", { class: "scroll" });
  private detail = h("section", { class: "panel narrow", "aria-label": "The run" });
  private marked = new Set<string>();
  private timer = 0;

  constructor(private compare: (ids: string[]) => void) {
    this.element = h("div", { class: "two" },
      h("section", { class: "panel grow", "aria-label": "Runs" }, h("div", { class: "row" }, h("h2", {}, "Runs"), this.search,
        h("button", { onclick: () => (this.marked.size ? this.compare([...this.marked]) : tell("Mark the runs to compare first", true)) }, "Compare marked")), this.table),
      this.detail);
  }

  private later(): void {
    clearTimeout(this.timer);
    this.timer = window.setTimeout(() => void this.show(), 200);
  }

  async show(): Promise<void> {
    const runs = await trying(() => get<RunShort[]>(`runs?limit=300&search=${encodeURIComponent(this.search.value)}`));
    if (!runs) return;
    fill(this.table, runs.length === 0 ? h("p", { class: "quiet" }, "No run.") : h("table", { class: "list" },
      h("thead", {}, h("tr", {}, ["", "started (UTC)", "name", "state", "samples", "lost", "model", "note"].map((t) => h("th", {}, t)))),
      h("tbody", {}, runs.map((r) => {
        const style = legend(r.name);
        const key = h("span", { "aria-hidden": "true" }, style.marker);
        key.style.color = style.colour;
        const box = h("input", { type: "checkbox", checked: this.marked.has(r.id), "aria-label": `mark ${r.id}`, onchange: () => { if (box.checked) this.marked.add(r.id); else this.marked.delete(r.id); } });
        return h("tr", {}, h("td", {}, box), h("td", {}, h("button", { class: "link", onclick: () => void this.open(r) }, r.started_utc.slice(0, 19).replace("T", " ") || r.id)),
          h("td", {}, key, " ", r.name), h("td", {}, h("span", { class: `tag ${r.state}` }, r.state), !r.clean && r.state === "done" ? " not clean" : ""),
          h("td", {}, String(r.samples)), h("td", {}, String(r.lost_samples)), h("td", { class: "quiet" }, r.model ?? ""), h("td", { class: "quiet" }, r.note ?? ""));
      }))));
  }

  private async open(r: RunShort): Promise<void> {
    const notes = await trying(() => get<{ text: string }>(`${run(r.id)}/notes`));
    const text = h("textarea", { rows: 6, value: notes?.text ?? "", "aria-label": "Notes" });
    const file = (format: string, label: string) => h("a", { href: `/api/v1/${run(r.id)}/export?format=${format}`, download: "" }, label);
    fill(this.detail, h("h2", {}, r.name), h("p", { class: "quiet" }, r.id), r.cause && h("p", {}, "First out: ", h("b", {}, r.cause)),
      h("p", {}, h("a", { href: `/api/v1/${run(r.id)}/report`, target: "_blank", rel: "noopener" }, "Report"), " · ", h("a", { href: `/api/v1/${run(r.id)}/events`, target: "_blank", rel: "noopener" }, "Events")),
      h("h3", {}, "Notes"), text, h("button", { onclick: (e: Event) => void trying(async () => { await put(`${run(r.id)}/notes`, { text: text.value }); tell("Notes are kept"); await this.show(); }, e.currentTarget as HTMLButtonElement) }, "Keep"),
      h("h3", {}, "Export"), h("p", { class: "row" }, file("csv", "CSV"), file("parquet", "Parquet"), file("mat", "MAT v7.3"), file("uff", "UFF58"), file("hdf5", "HDF5")));
  }
}
