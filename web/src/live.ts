// The live connection: status texts and binary frames, kept in buffers that the plots draw from. It comes
// back by itself after a loss; the table does not care either way.

import type { Status, Step } from "./types";

/** Channels of a frame, in the daemon's order. */
export const enum Ch { TableX, TableA, A, D, ModelA, ModelD, CommandX, CommandA, Step, Regime }
const WIDTH = 10;
const HEAD = 32;

/** The past of all channels: time and values grow at the end and are moved to the front once in a while. */
export class Past {
  time: Float64Array;
  channels: Float64Array[];
  from = 0;
  to = 0;
  constructor(private room: number) {
    this.time = new Float64Array(2 * room);
    this.channels = Array.from({ length: WIDTH }, () => new Float64Array(2 * room));
  }
  clear(): void { this.from = this.to = 0; }
  /** Makes room for more points and forgets what is older than the room. */
  grow(count: number): void {
    if (this.to + count <= this.time.length) return;
    const keep = Math.min(this.to - this.from, Math.max(0, this.time.length - count));
    const start = this.to - keep;
    this.time.copyWithin(0, start, this.to);
    for (const channel of this.channels) channel.copyWithin(0, start, this.to);
    this.from = 0;
    this.to = keep;
  }
  trim(): void { this.from = Math.max(this.from, this.to - this.room); }
  view(channel: Ch): Float64Array { return this.channels[channel].subarray(this.from, this.to); }
  times(): Float64Array { return this.time.subarray(this.from, this.to); }
  get length(): number { return this.to - this.from; }
  last(channel: Ch): number { return this.to > this.from ? this.channels[channel][this.to - 1] : 0; }
  get now(): number { return this.to > this.from ? this.time[this.to - 1] : 0; }
}

type Listener = { status: (s: Status) => void; step: (s: Step) => void; event: (e: Record<string, unknown>) => void; link: (up: boolean) => void };

export class Live {
  past = new Past(24576);
  status: Status | undefined;
  up = false;
  dropped = 0;
  frames = 0;
  gaps = 0;
  factor = 1;
  run = -1;
  windowS = 5;
  private zero = 0;
  private expected = -1;
  private socket: WebSocket | undefined;
  private wait = 250;
  private listeners: Partial<Listener>[] = [];

  on(listener: Partial<Listener>): void { this.listeners.push(listener); }

  private told<K extends keyof Listener>(what: K, value: Parameters<Listener[K]>[0]): void {
    for (const listener of this.listeners) (listener[what] as ((v: typeof value) => void) | undefined)?.(value);
  }

  connect(): void {
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    const socket = new WebSocket(`${scheme}://${location.host}/api/v1/live?window_s=${this.windowS}`);
    socket.binaryType = "arraybuffer";
    this.socket = socket;
    socket.onopen = () => { this.wait = 250; this.setUp(true); };
    socket.onmessage = (message) => {
      if (typeof message.data === "string") this.text(message.data);
      else this.frame(message.data as ArrayBuffer);
    };
    socket.onclose = () => {
      this.setUp(false);
      // Ever longer, so that a daemon that comes back is not run over.
      setTimeout(() => this.connect(), this.wait);
      this.wait = Math.min(2 * this.wait, 4000);
    };
  }

  private setUp(up: boolean): void {
    if (this.up === up) return;
    this.up = up;
    this.told("link", up);
  }

  window(seconds: number): void {
    this.windowS = seconds;
    if (this.socket?.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify({ window_s: seconds }));
  }

  private text(data: string): void {
    if (data === "") return;
    const message = JSON.parse(data);
    if (message.type === "status") {
      this.status = message.status;
      this.told("status", message.status);
    } else if (message.type === "event") {
      const event = message.event;
      if (event?.event === "step") this.told("step", event as Step);
      else this.told("event", event);
    }
  }

  private frame(data: ArrayBuffer): void {
    const head = new DataView(data);
    if (head.getUint8(0) !== 0x53 || head.getUint8(1) !== 1 || head.getUint8(3) !== WIDTH) return;
    const replaces = head.getUint8(2) === 1;
    const count = head.getUint32(4, true);
    const factor = head.getUint32(8, true);
    const run = head.getUint32(12, true);
    const first = Number(head.getBigUint64(16, true));
    this.dropped = head.getUint32(24, true);
    this.frames += 1;
    const rate = this.status?.setup.sample_rate_hz ?? 2048;
    if (replaces || run !== this.run) {
      this.past.clear();
      if (run !== this.run) this.zero = first;
      this.run = run;
      this.expected = -1;
    }
    // A frame of another window that was under way when the window changed.
    if (!replaces && factor !== this.factor && this.past.length > 0) return;
    this.factor = factor;
    if (this.expected >= 0 && first !== this.expected) this.gaps += 1;
    // Two points stand for `factor` rows.
    const rows = factor === 1 ? count : (count / 2) * factor;
    this.expected = first + rows;
    const past = this.past;
    past.grow(count);
    const at = past.to;
    const step = factor === 1 ? 1 : factor / 2;
    for (let i = 0; i < count; i++) past.time[at + i] = (first - this.zero + i * step) / rate;
    for (let c = 0; c < WIDTH; c++) {
      past.channels[c].set(new Float32Array(data, HEAD + 4 * c * count, count), at);
    }
    past.to = at + count;
    past.trim();
  }
}
