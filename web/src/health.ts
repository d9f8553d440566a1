// Health: timing of the control thread, rings, losses, links, clients, disk, versions, and who did what.

import { get } from "./api";
import type { Live } from "./live";
import type { Health } from "./types";
import { duration, fill, h, percent, short, trying } from "./ui";

interface Entry { at_utc: string; who: string; did: string; what: unknown }

function published(p: NonNullable<Health["publication"]>): string {
  const stands = p.connected ? "connected" : `not connected${p.error ? `: ${p.error}` : ""}`;
  return `${p.table} to ${p.server}, ${stands}; ${p.messages} messages, ${p.frames_dropped} frames dropped, ${(p.waiting_bytes / 1e3).toFixed(1)} kB wait`;
}

export class HealthScreen {
  element: HTMLElement;
  private numbers = h("div", {});
  private timing = h("div", {});
  private journal = h("div", { class: "scroll" });
  rate = 0;

  constructor(private live: Live) {
    this.element = h("div", { class: "two" },
      h("section", { class: "panel", "aria-label": "Health" }, h("h2", {}, "Health"), this.numbers),
      h("section", { class: "panel grow", "aria-label": "Timing and journal" }, h("h2", {}, "Control thread, last run"), this.timing, h("h2", {}, "Journal"), this.journal));
  }

  async show(): Promise<void> {
    const health = await trying(() => get<Health>("health"));
    if (!health) return;
    const rows: [string, string][] = [
      ["daemon", `shaketable ${health.version}, up ${duration(health.up_s)}`], ["system", health.system], ["rig", health.rig],
      ["real time", health.real_time ?? "no run goes on"], ["recorder ring", percent(health.ring_fill)],
      ["lost samples", String(health.lost_samples)], ["slips", String(health.slips)],
      ["last stop, request to command", health.stop_latency_s > 0 ? `${(1e3 * health.stop_latency_s).toFixed(2)} ms` : "–"],
      ["memory", `${(health.memory_bytes / 1e6).toFixed(0)} MB`], ["disk free", `${(health.disk_free_bytes / 1e9).toFixed(1)} GB`], ["runs in", health.runs_folder],
      ["live clients", String(health.clients)], ["frames sent / dropped", `${health.frames_sent} / ${health.frames_dropped}`],
      ["this page", `${this.live.up ? "connected" : "not connected"}, ${this.rate.toFixed(0)} frames/s, ${this.live.dropped} dropped`],
      ...(health.links?.map(({ name, count }): [string, string] => [name, String(count)]) ?? [["CRC and CAN errors", "simulated rig: no links"] as [string, string]]),
      ...(health.publication ? [["publication", published(health.publication)] as [string, string]] : []),
      ...(health.journal ? [["journal", health.journal] as [string, string]] : []),
    ];
    fill(this.numbers, h("table", { class: "small" }, h("tbody", {}, rows.map(([name, value]) => h("tr", {}, h("th", { scope: "row" }, name), h("td", {}, value))))));
    const t = health.timing;
    if (t) {
      const all = [["wake-up", t.wake_up_latency] as const, ["period error", t.period_error] as const, ["step", t.step] as const, ...t.phases.map((p) => [`· ${p.phase}`, p] as const)];
      const buckets = t.latency_histogram ?? [];
      const top = Math.max(1, ...buckets.map(([, n]) => Math.log10(1 + n)));
      fill(this.timing,
        buckets.length > 0 && h("figure", {}, h("figcaption", { class: "quiet" }, "Wake-up latency, counts on a logarithmic scale"),
          h("div", { class: "histogram" }, buckets.map(([us, n]) => {
            const bar = h("div", { title: `up to ${short(us)} µs: ${n}` });
            bar.style.height = `${(100 * Math.log10(1 + n)) / top}%`;
            return h("div", {}, h("div", { class: "tower" }, bar), h("small", {}, short(us)));
          })), h("p", { class: "quiet" }, "µs, upper end of each bar")),
        h("p", { class: "quiet" }, `${t.cycles} cycles, ${t.slips} slips of ${t.skipped_periods} periods; times in µs`),
        h("table", { class: "small" }, h("thead", {}, h("tr", {}, ["", "median", "99 %", "99.9 %", "largest"].map((x) => h("th", {}, x)))),
          h("tbody", {}, all.map(([name, p]) => h("tr", {}, h("th", { scope: "row" }, name), h("td", {}, short(p.p50_us)), h("td", {}, short(p.p99_us)), h("td", {}, short(p.p999_us)), h("td", {}, short(p.max_us)))))));
    } else fill(this.timing, h("p", { class: "quiet" }, "No run has ended yet."));
    const entries = (await trying(() => get<Entry[]>("journal"))) ?? [];
    fill(this.journal, h("table", { class: "small" }, h("tbody", {}, entries.reverse().slice(0, 60).map((e) => h("tr", {}, h("td", {}, e.at_utc.slice(11, 19)), h("td", {}, h("b", {}, e.did)), h("td", {}, e.who), h("td", { class: "quiet" }, JSON.stringify(e.what).slice(0, 120)))))));
  }
}
