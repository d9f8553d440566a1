// Building blocks of all screens: elements, numbers as operators read them, colours that colour-blind readers
// can tell apart (Okabe and Ito 2008), messages.

type Child = Node | string | number | null | undefined | false;
type Props = Record<string, unknown>;

/** Makes an element: properties, `on...` listeners, `class`, attributes with a dash, children. */
export function h<K extends keyof HTMLElementTagNameMap>(
  tag: K, props: Props = {}, ...children: (Child | Child[])[]
): HTMLElementTagNameMap[K] {
  const element = document.createElement(tag);
  for (const [key, value] of Object.entries(props)) {
    if (value === undefined || value === null || value === false) continue;
    if (key.startsWith("on")) element.addEventListener(key.slice(2), value as EventListener);
    else if (key === "class") element.className = String(value);
    else if (key.includes("-") || key === "role" || key === "for") element.setAttribute(key, String(value));
    else Object.assign(element, { [key]: value });
  }
  element.append(...children.flat().filter((c): c is Node | string | number => c !== null && c !== undefined && c !== false).map((c) => (c instanceof Node ? c : String(c))));
  return element;
}

/** Replaces what an element holds. */
export function fill(element: Element, ...children: (Child | Child[])[]): void {
  const kept = children.flat().filter((c): c is Node | string | number => c !== null && c !== undefined && c !== false);
  element.replaceChildren(...kept.map((c) => (c instanceof Node ? c : String(c))));
}

/** Sets a text only where it differs, so that screen readers are told of changes alone. */
export function say(element: Element, text: string): void {
  if (element.textContent !== text) element.textContent = text;
}

export const percent = (x: number | null | undefined, digits = 1): string =>
  x === null || x === undefined || !Number.isFinite(x) ? "–" : `${(100 * x).toFixed(digits)} %`;
export const fixed = (x: number | null | undefined, digits: number): string =>
  x === null || x === undefined || !Number.isFinite(x) ? "–" : x.toFixed(digits);
export const mm = (x: number | null | undefined, digits = 1): string =>
  x === null || x === undefined ? "–" : fixed(1e3 * x, digits);

/** Four significant digits, whatever the magnitude. */
export function short(x: number | null | undefined): string {
  if (x === null || x === undefined || !Number.isFinite(x)) return "–";
  const size = Math.abs(x);
  return size !== 0 && (size < 1e-3 || size >= 1e6) ? x.toExponential(2) : String(Number(x.toPrecision(4)));
}

/** The same with its unit; a number without one ("1") stands alone. */
export const quantity = (x: number | null | undefined, unit: string): string => (unit === "1" ? short(x) : `${short(x)} ${unit}`);

/** A time as operators say it. */
export function duration(s: number): string {
  if (!Number.isFinite(s)) return "–";
  const whole = Math.round(s);
  return whole < 60 ? `${whole} s` : `${Math.floor(whole / 60)}:${String(whole % 60).padStart(2, "0")} min`;
}

export const dark = (): boolean => matchMedia("(prefers-color-scheme: dark)").matches;

/** A colour of the style sheet. */
export const ink = (name: string): string => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();

/** The paper's legend where cases are compared: colour = bumper, marker = gap, line style = A_G. */
export function legend(name: string | null): { colour: string; marker: string; dash: number[] } {
  const [, bumper, gap, ag] = /^B(\d)(?:-G(\d))?-([\d.]+)/.exec(name ?? "") ?? [];
  const colours = [ink("b0"), ink("b1"), ink("b2"), ink("b3"), ink("b4")];
  const markers = ["○", "□", "△", "◇", "▽"];
  const dashes: Record<string, number[]> = { "0.03": [2, 3], "0.04": [6, 4], "0.05": [], "0.07": [10, 3, 2, 3] };
  return {
    colour: colours[Number(bumper ?? 0)] ?? ink("text"),
    marker: markers[Number(gap ?? 0)] ?? "○",
    dash: dashes[Number(ag ?? 0.05).toFixed(2)] ?? [],
  };
}

let told: HTMLElement | undefined;
let hiding = 0;

/** A message at the foot of the page; refusals stay until the next one. */
export function tell(text: string, bad = false): void {
  told ??= document.body.appendChild(h("div", { class: "told", role: "status", "aria-live": "polite" }));
  told.className = bad ? "told bad" : "told";
  told.textContent = text;
  clearTimeout(hiding);
  hiding = window.setTimeout(() => { if (told) told.textContent = ""; }, bad ? 12000 : 4000);
}

/** Runs something and shows its refusal. */
export async function trying<T>(work: () => Promise<T>, button?: HTMLButtonElement): Promise<T | undefined> {
  if (button) button.disabled = true;
  try {
    return await work();
  } catch (error) {
    tell(error instanceof Error ? error.message : String(error), true);
    return undefined;
  } finally {
    if (button) button.disabled = false;
  }
}
