// The operator's page: head with STOP, screens, keys. The page is a convenience: losing it changes nothing on
// the table.

import { Refused, del, get, post } from "./api";
import { Bench } from "./bench";
import { Curves } from "./curves";
import { Fails } from "./fails";
import { HealthScreen } from "./health";
import { Live } from "./live";
import { Missing } from "./missing";
import { Runs } from "./runs";
import { SweepScreen } from "./sweep";
import type { Rights, Status } from "./types";
import { fill, h, say, tell, trying } from "./ui";

const live = new Live();
let rights: Rights = { view: false, operate: false, configure: false };
let tokenNeeded = false;
let screen = "bench";

const bench = new Bench(live, () => rights);
const sweep = new SweepScreen(() => undefined);
const curves = new Curves();
const fails = new Fails();
const missing = new Missing(() => undefined, (wanted, note) => {
  go("sweep", () => sweep.show(live.status, wanted).then(() => tell(note)));
});
const runs = new Runs((ids) => {
  curves.beneath = new Set(ids);
  go("curves");
});
const health = new HealthScreen(live);

const screens: [string, string, HTMLElement, () => unknown][] = [
  ["bench", "Bench", bench.element, () => undefined],
  ["sweep", "Sweep", sweep.element, () => sweep.show(live.status)],
  ["curves", "Curves", curves.element, () => curves.show(live.status)],
  ["fails", "Where it fails", fails.element, () => fails.show(live.status)],
  ["missing", "What is missing", missing.element, () => missing.show(live.status)],
  ["runs", "Runs", runs.element, () => runs.show()],
  ["health", "Health", health.element, () => health.show()],
];

const stop = h("button", { class: "stop", "aria-keyshortcuts": "Escape", onclick: () => void askStop() }, "STOP", h("small", {}, "Esc"));
const link = h("span", { class: "link-state", role: "status" });
const rig = h("span", { class: "quiet rigname" });
const badge = h("span", { class: "badge" });
const person = h("button", { class: "link", onclick: () => void introduce() });
const nav = h("nav", { "aria-label": "Screens" }, screens.map(([id, name], i) => h("a", { href: `#${id}`, "data-screen": id, title: `key ${i + 1}` }, name)));
const main = h("main", { id: "main" });

/** A stop goes out by HTTP, whatever the live connection does; it is tried again until it is answered. */
async function askStop(): Promise<void> {
  stop.classList.add("asked");
  for (let tries = 0; tries < 20; tries++) {
    try {
      await post("session/stop");
      stop.classList.remove("asked");
      return;
    } catch (error) {
      if (error instanceof Refused && error.status !== 0) {
        tell(error.message, true);
        break;
      }
      tell("STOP has not reached the daemon yet: trying on. Use the hardware stop.", true);
      await new Promise((done) => setTimeout(done, 500));
    }
  }
  stop.classList.remove("asked");
}

function go(id: string, shown?: () => unknown): void {
  const found = screens.find(([known]) => known === id) ?? screens[0];
  screen = found[0];
  if (location.hash !== `#${screen}`) history.replaceState(null, "", `#${screen}`);
  fill(main, found[2]);
  for (const a of nav.querySelectorAll("a")) {
    if (a.dataset.screen === screen) a.setAttribute("aria-current", "page");
    else a.removeAttribute("aria-current");
  }
  document.title = `${found[1]} · shaking table`;
  void (shown ?? found[3])();
}

function update(s: Status): void {
  say(rig, `${s.setup.rig} · ${s.setup.case ?? s.setup.model}`);
  say(badge, s.state);
  badge.dataset.state = s.state;
  stop.dataset.live = String(["running", "holding", "stopping"].includes(s.state));
  if (s.run?.id) curves.begin(s.run.id);
}

/** Asks who is there; with tokens, for one. */
async function introduce(): Promise<void> {
  const dialog = h("dialog", { class: "panel" });
  const name = h("input", { type: "text", maxLength: 40, value: localStorage.getItem("operator") ?? "", autocomplete: "name" });
  const token = h("input", { type: "password", autocomplete: "off" });
  const close = () => { dialog.close(); dialog.remove(); };
  dialog.append(h("form", { method: "dialog", class: "form", onsubmit: (e: Event) => {
    e.preventDefault();
    localStorage.setItem("operator", name.value.trim());
    void trying(async () => {
      if (token.value !== "") await post("login", { token: token.value });
      token.value = "";
      close();
      await whoAmI();
    });
  } },
  h("h2", {}, "Who is at the desk?"), h("label", {}, h("span", {}, "Name for the journal"), name),
  tokenNeeded && h("label", {}, h("span", {}, "Token"), token),
  tokenNeeded && h("p", { class: "quiet" }, "The tokens are in the daemon's token file. A second token adds its right to the first."),
  h("div", { class: "row" }, h("button", { class: "loud", type: "submit" }, "Go on"),
    tokenNeeded && rights.view && h("button", { type: "button", onclick: () => void trying(async () => { await del("login"); location.reload(); }) }, "Log out"),
    h("button", { type: "button", onclick: close }, "Close"))));
  document.body.append(dialog);
  dialog.showModal();
}

async function whoAmI(): Promise<void> {
  const said = await trying(() => get<{ token_needed: boolean; rights: Rights }>("login"));
  if (!said) return;
  const first = !rights.view && said.rights.view;
  rights = said.rights;
  tokenNeeded = said.token_needed;
  const may = [rights.operate && "operate", rights.configure && "configure"].filter(Boolean).join(", ") || (rights.view ? "view and stop" : "log in");
  say(person, `${localStorage.getItem("operator") || "Name?"} · may ${may}`);
  if (first) live.connect();
  else if (!rights.view) await introduce();
  if (live.status) bench.update(live.status);
}

addEventListener("keydown", (event) => {
  if (event.key === "Escape" && !document.querySelector("dialog[open]")) {
    event.preventDefault();
    void askStop();
    return;
  }
  const at = event.target as HTMLElement;
  if (event.ctrlKey || event.altKey || event.metaKey || /INPUT|SELECT|TEXTAREA/.test(at.tagName)) return;
  const index = Number(event.key) - 1;
  if (index >= 0 && index < screens.length) go(screens[index][0]);
  else if (event.key === "p" && screen === "bench") bench.scope.pause(!bench.scope.paused);
});
addEventListener("hashchange", () => go(location.hash.slice(1)));
nav.addEventListener("click", (event) => {
  const id = (event.target as HTMLElement).dataset.screen;
  if (id) { event.preventDefault(); go(id); }
});
// Colours of plots are taken when they are made.
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => location.reload());

live.on({
  status: update,
  step: (step) => curves.add(step),
  link: (up) => {
    say(link, up ? "" : "connection lost: the table goes on as it was told; trying again");
    document.body.classList.toggle("lost", !up);
    if (up && screen === "curves") void curves.show(live.status);
  },
  event: (event) => { if (event.event === "rig-fault" || event.event === "recorder") tell(`${event.fault ?? event.text ?? event.event}`, true); },
});

fill(document.getElementById("app") ?? document.body,
  h("a", { class: "skip", href: "#main", onclick: () => main.focus() }, "To the screen"),
  h("header", {}, h("div", { class: "brand" }, h("b", {}, "Shaking table"), rig), badge, nav, person, stop), link, main);
main.tabIndex = -1;

function frame(time: number): void {
  if (screen === "bench") bench.draw(time);
  const drawn = bench.scope.drawn.filter((t) => t > time - 1000).length;
  health.rate = drawn;
  requestAnimationFrame(frame);
}

go(location.hash.slice(1) || "bench");
void whoAmI();
setInterval(() => { if (screen === "health") void health.show(); }, 3000);
requestAnimationFrame(frame);
// For measurements of the page itself.
Object.assign(window, { shaketable: { live, scope: bench.scope } });
