// The bench: state, interlocks, controls, progress, meters, the live scope and the picture of the rig.

import { post } from "./api";
import type { Live } from "./live";
import { Rig } from "./rig";
import { Scope } from "./scope";
import type { Rights, Status } from "./types";
import { duration, fill, fixed, h, mm, percent, say, short, trying } from "./ui";

const WORDS: Record<string, string> = {
  idle: "Idle", "pre-flight": "Pre-flight", armed: "Armed", running: "Running", holding: "Holding",
  stopping: "Stopping", stopped: "Stopped", aborted: "Aborted",
};

export class Bench {
  element: HTMLElement;
  scope: Scope;
  private rig = new Rig();
  private state = h("strong", { class: "state", "aria-live": "polite" });
  private since = h("span", { class: "quiet" });
  private hint = h("p", { class: "hint" });
  private controls = h("div", { class: "controls" });
  private cause = h("div", { class: "cause", role: "alert" });
  private chain = h("ul", { class: "chain" });
  private progress = h("div", { class: "progress" });
  private meters = h("div", { class: "meters" });
  private checks = h("div", { class: "checks" });
  private shown = "";

  constructor(private live: Live, private rights: () => Rights) {
    this.scope = new Scope(live);
    this.element = h("div", { class: "bench" },
      h("section", { class: "panel desk", "aria-label": "State and controls" },
        h("div", { class: "row" }, this.state, this.since), this.cause, this.hint, this.controls, this.checks, this.progress,
        h("h2", {}, "Interlocks"), this.chain, h("h2", {}, "Newest cycle"), this.meters),
      h("div", { class: "panel middle" }, this.scope.element),
      h("section", { class: "panel side", "aria-label": "Rig and loops" }, this.rig.element as unknown as HTMLElement,
        this.scope.loop.element, this.scope.portrait.element));
    live.on({ status: (s) => this.update(s) });
  }

  draw(time: number): void {
    this.scope.attach();
    this.scope.draw(time);
    this.rig.draw(this.live.past, this.live.status);
  }

  private button(action: string, label: string, body?: unknown, loud = false): HTMLButtonElement {
    const button = h("button", {
      class: loud ? "loud" : "", "data-action": action,
      onclick: () => trying(() => post(`session/${action}`, body), button),
    }, label);
    button.disabled = !this.rights().operate;
    if (button.disabled) button.title = "needs the operator's token";
    return button;
  }

  update(s: Status): void {
    say(this.state, WORDS[s.state] ?? s.state);
    this.state.dataset.state = s.state;
    say(this.since, `since ${s.since_utc.slice(11, 19)} UTC`);
    // Buttons are made again only when what they do changes: a click must not fall between two of them.
    const key = JSON.stringify([s.state, s.possible, s.checked?.id, s.checking, s.cause, this.rights()]);
    if (key !== this.shown) {
      this.shown = key;
      this.show(s);
    }
    fill(this.chain, s.interlocks.map((link) => h("li", { class: link.ok ? "ok" : "open", title: link.text },
      h("span", { class: "mark", "aria-hidden": "true" }, link.ok ? "✓" : "○"), h("span", {}, link.name),
      h("span", { class: "quiet" }, link.text))));
    this.run(s);
    this.read(s);
  }

  private show(s: Status): void {
    const hints: Record<string, string> = {
      idle: "Check the rig first: links, zeros and noise at rest, a small sine around the loop, the sweep against the table.",
      "pre-flight": s.checking ? "Checking…" : s.checked?.passed ? "Are these zeros and this noise right? Confirm to arm." : "The checks have not passed.",
      armed: "Armed: the sweep may be started. Keep clear of the table.",
      running: "Hold waits at the end of the present step; Stop brings the table to rest.",
      holding: "The table stays in its step until it is resumed.",
      stopping: "The table is brought to rest.",
      stopped: "The run is over. See Where it fails, or check again for the next one.",
      aborted: "Ended by the supervisor. Find the cause, then acknowledge it.",
    };
    say(this.hint, hints[s.state] ?? "");
    const can = (action: string) => s.possible.includes(action) && !s.checking;
    fill(this.controls,
      can("pre-flight") && this.button("pre-flight", s.state === "pre-flight" ? "Check again" : "Check the rig", undefined, s.state !== "pre-flight"),
      can("arm") && s.checked?.passed && this.button("arm", "Confirm and arm", { pre_flight: s.checked.id }, true),
      can("start") && this.button("start", "Start the sweep", undefined, true),
      can("disarm") && this.button("disarm", "Disarm"),
      can("hold") && this.button("hold", "Hold"),
      can("resume") && this.button("resume", "Resume", undefined, true),
      can("reset") && s.cause && this.button("reset", `Acknowledge “${s.cause.detector}” and reset`, { cause: s.cause.detector }, true));
    fill(this.cause, s.cause && [h("b", {}, "First out: "), s.cause.detector, h("div", { class: "quiet" }, `${s.cause.text}, ${s.cause.at_utc.slice(11, 19)} UTC`)]);
    this.checks.hidden = !(s.checked && (s.state === "pre-flight" || s.state === "armed"));
    if (s.checked) {
      fill(this.checks,
        h("ul", { class: "chain" }, s.checked.lines.map((line) => h("li", { class: line.ok ? "ok" : line.required ? "bad" : "open" },
          h("span", { class: "mark", "aria-hidden": "true" }, line.ok ? "✓" : line.required ? "✗" : "!"), h("span", {}, line.name), h("span", { class: "quiet" }, line.found)))),
        s.checked.channels.length > 0 && h("table", { class: "small" }, h("thead", {}, h("tr", {}, h("th", {}, "at rest"), h("th", {}, "zero"), h("th", {}, "noise"), h("th", {}, "gain"))),
          h("tbody", {}, s.checked.channels.map((c) => h("tr", {}, h("td", {}, c.channel),
            h("td", {}, c.unit === "m" ? `${fixed(1e6 * c.zero, 1)} µm` : `${fixed(1e3 * c.zero, 2)} mm/s²`),
            h("td", {}, c.unit === "m" ? `${fixed(1e6 * c.noise, 1)} µm` : `${fixed(1e3 * c.noise, 2)} mm/s²`),
            h("td", {}, fixed(c.gain, 3)))))));
    }
  }

  private run(s: Status): void {
    const r = s.run;
    if (r) {
      fill(this.progress,
        h("div", { class: "row" }, h("span", {}, r.step === null ? "on the way to the first step" : `step ${r.step + 1} of ${r.steps}: ${fixed(r.frequency_hz, 2)} Hz ${r.direction}`),
          h("span", { class: "spring-right quiet" }, `${duration(r.eta_s)} left`)),
        h("progress", { value: r.progress, max: 1, "aria-label": "Progress of the sweep" }),
        h("div", { class: "quiet" }, `model error A ${percent(r.nrmse_a)}, D ${percent(r.nrmse_d)} · lost ${r.lost_samples} · slips ${r.slips}`),
        r.evidence && h("div", { class: "quiet", "data-evidence": "" }, `missing so far (${r.evidence.steps} steps): ${r.evidence.candidates.slice(0, 3).map((c) => `${c.name} ${c.evidence_nats.toFixed(0)} nats`).join(", ") || "nothing"}`));
    } else if (s.ended) {
      const e = s.ended;
      fill(this.progress, h("div", {}, `Last run ${e.id}: ${e.outcome}`),
        h("div", { class: "quiet" }, `model error A ${percent(e.nrmse_a)}, D ${percent(e.nrmse_d)} · ${e.samples} samples, ${e.lost_samples} lost · slips ${e.slips}`));
    } else fill(this.progress);
  }

  private read(s: Status): void {
    const m = s.meters, ag = 9.80665 * s.setup.acceleration_g;
    const half = s.setup.total_gap_m === null ? null : s.setup.total_gap_m / 2;
    const meter = (name: string, value: string, unit: string, share: number | null, note = "") =>
      h("div", { class: "meter" }, h("span", { class: "quiet" }, name), h("b", {}, value), h("span", { class: "quiet" }, ` ${unit}`),
        share !== null && h("meter", { min: 0, max: 1, high: 0.9, value: Math.min(1, Math.max(0, share)), "aria-label": name }),
        note !== "" && h("small", { class: "quiet" }, note));
    fill(this.meters,
      meter("Table acceleration", fixed(m.table_acceleration_m_s2, 2), "m/s²", m.table_acceleration_m_s2 / (2 * ag), `A_G ${fixed(ag, 2)}`),
      meter("A", fixed(m.mass_acceleration_m_s2, 2), "m/s²", m.mass_acceleration_m_s2 / 18, `model ${fixed(m.model_acceleration_m_s2, 2)}`),
      meter("Excursion", mm(m.excursion_m), "mm", null, `model ${mm(m.model_excursion_m)}`),
      meter("D now", mm(m.relative_displacement_m), "mm", half === null ? null : Math.abs(m.relative_displacement_m) / (2 * half), half === null ? "no bumpers" : `contact at ±${mm(half)}`),
      meter("Phase lag of D", fixed(m.phase_deg, 0), "°", Math.abs(m.phase_deg) / 180),
      meter("Oscillations / cycle", fixed(m.oscillations, 1), "", m.oscillations / 4.5, "trips at 4.5"),
      meter("Contacts / cycle", String(m.contacts), "", null),
      meter("Difference A, D", `${percent(m.residual_a)}, ${percent(m.residual_d)}`, "", null, `at ${short(m.frequency_hz)} Hz`));
  }
}
