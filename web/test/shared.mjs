// What the browser tests share: a daemon on a free port, a browser, pictures.
import { spawn } from "node:child_process";
import { mkdir, mkdtemp } from "node:fs/promises";
import { tmpdir } from "node:os";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";
import { chromium } from "playwright-core";

const here = dirname(fileURLToPath(import.meta.url));
export const root = join(here, "..", "..");
export const pictures = process.env.PICTURES ?? join(root, "target", "pictures");
const binary = process.env.SHAKETABLE ?? join(root, "target", "release", "shaketable");

/** Starts a daemon; resolves once it listens. */
export async function daemon(...args) {
  const folder = await mkdtemp(join(tmpdir(), "desk-"));
  const child = spawn(binary, ["serve", "--listen", "127.0.0.1:0", "--out", join(folder, "runs"), ...args], { cwd: folder });
  let log = "";
  child.stderr.on("data", (text) => { log += text; });
  const address = await new Promise((done, failed) => {
    child.stdout.on("data", (text) => done(String(text).trim()));
    child.on("exit", (code) => failed(new Error(`the daemon ended with ${code}: ${log}`)));
  });
  const ended = new Promise((done) => child.on("exit", done));
  // A test that fails must not leave its daemon behind.
  process.on("exit", () => child.kill("SIGTERM"));
  return {
    address, folder, child, log: () => log,
    get: async (path) => (await fetch(`${address}/api/v1/${path}`)).json(),
    post: async (path, body) => (await fetch(`${address}/api/v1/${path}`, {
      method: "POST", headers: body ? { "content-type": "application/json" } : {}, body: body ? JSON.stringify(body) : undefined,
    })).json(),
    put: async (path, body) => (await fetch(`${address}/api/v1/${path}`, {
      method: "PUT", headers: { "content-type": "application/json" }, body: JSON.stringify(body),
    })).json(),
    close: async () => { child.kill("SIGTERM"); await ended; },
  };
}

/** Starts the browser of the machine. */
export async function browser() {
  await mkdir(pictures, { recursive: true });
  return chromium.launch({ executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium", args: ["--no-sandbox", "--disable-gpu", ...(process.env.FLAGS ?? "").split(" ").filter(Boolean)] });
}

/** Waits for a state of the bench by asking the daemon, not the page. */
export async function until(server, wanted, seconds, what = (s) => s.state) {
  const end = Date.now() + 1000 * seconds;
  let last;
  while (Date.now() < end) {
    last = await server.get("status");
    if (wanted(last)) return last;
    await new Promise((done) => setTimeout(done, 200));
  }
  throw new Error(`not within ${seconds} s; the bench is ${what(last)}: ${JSON.stringify(last.cause)}`);
}

export const picture = (page, name, options = {}) => page.screenshot({ path: join(pictures, `${name}.png`), ...options });
