// Load beside a run: 50 WebSocket clients, 10 of which read nothing, and 200 requests a second, switched on and
// off in turn within one run, so that slips with and without them are compared on the same machine at the same
// time. The idle ten stay from the first turn to the end, long enough for their sockets to fill. Where `cyclictest` is
// installed it runs beside the control thread, one priority below it: what it sees late is the machine's.
// `node load.mjs [seconds] [seconds of a turn]`; prints one JSON object.
import { execFile } from "node:child_process";
import { createHash, randomBytes } from "node:crypto";
import { readFile } from "node:fs/promises";
import http from "node:http";
import net from "node:net";
import { join } from "node:path";
import { daemon, until } from "./shared.mjs";

const seconds = Number(process.argv[2] ?? 600), turn = Number(process.argv[3] ?? 30);
const CLIENTS = 50, IDLE = 10, RATE = 200;
const server = await daemon("--sweep", "andreaus-2020");
const { hostname, port } = new URL(server.address);
// One long dwell: as many cycles as the time needs.
await server.put("setup/sweep", { dwell_hz: 2, cycles: Math.ceil(2 * seconds), direction: "forward", acceleration_g: 0.03 });
const checked = await server.post("session/pre-flight");
await server.post("session/arm", { pre_flight: checked.id });
const { id } = await server.post("session/start");

/** A WebSocket of few words: counts frames, or never reads. */
function client(reads) {
  const socket = net.connect(Number(port), hostname);
  const key = randomBytes(16).toString("base64");
  socket.write(`GET /api/v1/live?window_s=5 HTTP/1.1\r\nHost: ${hostname}:${port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: ${key}\r\n\r\n`);
  const seen = { bytes: 0, accepted: false, closed: false };
  socket.on("error", () => {}).on("close", () => { seen.closed = true; });
  socket.once("data", (data) => {
    const accept = createHash("sha1").update(`${key}258EAFA5-E914-47DA-95CA-C5AB0DC85B11`).digest("base64");
    seen.accepted = data.includes(accept);
    if (!reads) socket.pause();
  });
  if (reads) socket.on("data", (data) => { seen.bytes += data.length; });
  return { socket, seen };
}

const agent = new http.Agent({ keepAlive: true, maxSockets: 32 });
const paths = ["/api/v1/status", "/api/v1/health", "/metrics", "/api/v1/setup", "/api/v1/session/steps"];
let asked = 0, answered = 0, refused = 0;
function request() {
  const path = paths[asked++ % paths.length];
  http.get({ hostname, port, path, agent }, (answer) => {
    if (answer.statusCode === 200) answered += 1;
    else refused += 1;
    answer.resume();
  }).on("error", () => { refused += 1; });
}

/** Wake-ups later than one period of the control thread, as cyclictest sees them; `null` where there is none. */
function reference(duration) {
  const period = 488;
  const words = ["-q", "-m", "-a", "1", "-p", "79", "-t", "1", "-i", String(period), "-h", String(period), "-D", String(duration)];
  return new Promise((done) => execFile("cyclictest", words, (error, out) => {
    const overflows = /# Histogram Overflows: (\d+)/.exec(out ?? ""), worst = /# Max Latencies: (\d+)/.exec(out ?? "");
    done(error || !overflows ? null : { late: Number(overflows[1]), worst_us: Number(worst?.[1]) });
  }));
}

const turns = [];
const idle = [];
const memory = [];
let clients = [], loaded = false, last = Date.now(), owed = 0, closedByServer = 0, bytes = 0;
const begun = Date.now();
const status = () => server.get("status");
let from = (await status()).run.elapsed_s;
const pace = setInterval(() => {
  const now = Date.now();
  if (loaded) {
    owed += ((now - last) / 1000) * RATE;
    while (owed >= 1) { request(); owed -= 1; }
  }
  last = now;
}, 5);

while (Date.now() - begun < 1000 * seconds) {
  loaded = !loaded;
  while (idle.length < IDLE) idle.push(client(false));
  if (loaded) clients = Array.from({ length: CLIENTS - IDLE }, () => client(true));
  const beside = reference(turn);
  for (let t = 0; t < turn; t += 5) {
    await new Promise((done) => setTimeout(done, 5000));
    memory.push((await server.get("health")).memory_bytes);
  }
  const seen = await beside;
  const s = await status();
  if (!s.run) throw new Error(`the run ended: ${JSON.stringify(s.cause ?? s.ended)}`);
  turns.push({ loaded, from, to: s.run.elapsed_s, seen });
  from = s.run.elapsed_s;
  for (const { socket, seen } of clients) {
    bytes += seen.bytes;
    closedByServer += seen.closed ? 1 : 0;
    socket.destroy();
  }
  clients = [];
  owed = 0;
}
clearInterval(pace);
const health = await server.get("health");
for (const { socket, seen } of idle) {
  closedByServer += seen.closed ? 1 : 0;
  socket.destroy();
}
await server.post("session/stop");
const ended = await until(server, (s) => s.state === "stopped" || s.state === "aborted", 30);
const manifest = await server.get(`runs/${id}`);
const rate = manifest.sample_rate_hz;
const events = (await readFile(join(server.folder, "runs", id, "events.jsonl"), "utf8")).trim().split("\n").map((line) => JSON.parse(line));
const slips = events.filter((e) => e.event === "slip");
const sum = (on) => {
  const mine = turns.filter((t) => t.loaded === on);
  const time = mine.reduce((s, t) => s + t.to - t.from, 0);
  const count = slips.filter((e) => mine.some((t) => e.cycle / rate >= t.from && e.cycle / rate < t.to));
  const cyclictest = mine.every((t) => t.seen) ? { late: mine.reduce((s, t) => s + t.seen.late, 0), worst_us: Math.max(...mine.map((t) => t.seen.worst_us)) } : null;
  return { seconds: time, cyclictest, slips: count.length, periods: count.reduce((s, e) => s + e.periods, 0), slips_a_minute: (60 * count.length) / time };
};
const half = Math.floor(memory.length / 2), mean = (x) => x.reduce((a, b) => a + b, 0) / Math.max(1, x.length);
console.log(JSON.stringify({
  outcome: ended.ended?.outcome, samples: ended.ended?.samples, lost_samples: ended.ended?.lost_samples,
  with: sum(true), without: sum(false), ratio: sum(true).slips_a_minute / Math.max(1e-9, sum(false).slips_a_minute),
  requests: { asked, answered, refused }, live: { bytes, frames_sent: health.frames_sent, frames_dropped: health.frames_dropped, closed_by_server: closedByServer },
  memory_mb: { each_half_minute: memory.filter((_, i) => i % 6 === 5).map((m) => Math.round(m / 1e5) / 10), first_half: mean(memory.slice(1, half)) / 1e6, second_half: mean(memory.slice(half)) / 1e6, largest: Math.max(...memory) / 1e6 },
  stop_latency_ms: 1e3 * (await server.get("health")).stop_latency_s, timing: ended.ended?.timing?.wake_up_latency,
}, null, 1));
await server.close();
