// Pages come and go: closed in mid-run, reloaded, five more opened, the network cut and mended, STOP pressed
// while it is cut. The run does not care, and nothing is lost.
import assert from "node:assert/strict";
import net from "node:net";
import { browser, daemon, picture, until } from "./shared.mjs";

const server = await daemon("--sweep", "quick");
const port = Number(new URL(server.address).port);

/** A wire that can be cut: bytes go through with the daemon's own port in place of the wire's. */
function wire() {
  const open = new Set();
  let cut = false;
  const through = net.createServer((near) => {
    if (cut) { near.destroy(); return; }
    const far = net.connect(port, "127.0.0.1");
    for (const end of [near, far]) {
      open.add(end);
      end.on("error", () => {}).on("close", () => { open.delete(end); near.destroy(); far.destroy(); });
    }
    const own = `127.0.0.1:${through.address().port}`;
    near.on("data", (data) => far.write(Buffer.from(data.toString("latin1").replaceAll(own, `127.0.0.1:${port}`), "latin1")));
    far.pipe(near);
  });
  return new Promise((done) => through.listen(0, "127.0.0.1", () => done({
    address: `http://127.0.0.1:${through.address().port}`,
    cut: () => { cut = true; for (const end of open) end.destroy(); },
    mend: () => { cut = false; },
    close: () => through.close(),
  })));
}

const line = await wire();
const chrome = await browser();
const live = (page) => page.evaluate(() => ({ frames: window.shaketable.live.frames, gaps: window.shaketable.live.gaps, dropped: window.shaketable.live.dropped, points: window.shaketable.live.past.length, up: window.shaketable.live.up }));
const newest = async () => (await server.get("status")).run?.elapsed_s ?? 0;

let page = await chrome.newPage({ viewport: { width: 1280, height: 720 } });
await page.goto(line.address);
await page.click('[data-action="pre-flight"]');
await page.click('[data-action="arm"]');
await page.click('[data-action="start"]');
await until(server, (s) => (s.run?.elapsed_s ?? 0) > 3, 30);

console.log("the page is closed");
await page.close();
const closed = await newest();
await until(server, (s) => s.run.elapsed_s > closed + 3, 20);
await until(server, (s) => s.state === "running", 1);

console.log("opened again and reloaded");
page = await chrome.newPage({ viewport: { width: 1280, height: 720 } });
await page.goto(line.address);
await page.waitForFunction(() => window.shaketable?.live.past.length > 9000, undefined, { timeout: 20000 });
await page.reload();
await page.waitForFunction(() => window.shaketable?.live.past.length > 9000, undefined, { timeout: 20000 });
await page.waitForSelector('.badge[data-state="running"]');

console.log("five more");
const more = await Promise.all(Array.from({ length: 5 }, async () => {
  const other = await chrome.newPage();
  await other.goto(server.address);
  await other.waitForFunction(() => window.shaketable?.live.frames > 20, undefined, { timeout: 40000 });
  return other;
}));
for (const other of more) {
  const seen = await live(other);
  assert.ok(seen.up && seen.points > 5000, JSON.stringify(seen));
}

console.log("the network is cut");
line.cut();
await page.waitForFunction(() => document.body.classList.contains("lost"), undefined, { timeout: 20000 });
const cut = await newest();
await picture(page, "20-network-cut");
await until(server, (s) => s.run.elapsed_s > cut + 3, 20);
await until(server, (s) => s.state === "running", 1);
line.mend();
await page.waitForFunction(() => !document.body.classList.contains("lost"), undefined, { timeout: 20000 });
await page.waitForFunction(() => window.shaketable.live.past.length > 9000, undefined, { timeout: 20000 });

console.log("STOP while it is cut, by key");
line.cut();
await page.waitForFunction(() => document.body.classList.contains("lost"), undefined, { timeout: 20000 });
await page.keyboard.press("Escape");
await page.waitForFunction(() => document.querySelector(".told")?.textContent.includes("has not reached"), undefined, { timeout: 10000 });
await until(server, (s) => s.state === "running", 1);
line.mend();
const stopped = await until(server, (s) => s.state === "stopped", 30);
assert.equal(stopped.ended.outcome, "stopped");
assert.equal(stopped.ended.lost_samples, 0);
const health = await server.get("health");
console.log(`stopped; from request to first command ${(1e3 * health.stop_latency_s).toFixed(3)} ms; ${stopped.ended.samples} samples, none lost`);
assert.ok(health.stop_latency_s > 0);
const journal = await server.get("journal");
assert.deepEqual(journal.map((e) => e.did), ["pre-flight", "arm", "start", "stop"]);
await chrome.close();
line.close();
await server.close();
console.log("nothing was lost");
