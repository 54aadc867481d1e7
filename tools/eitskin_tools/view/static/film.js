// A recording: parts of a second, fetched around the moment that is shown, and an overview of the whole file.

import { indexAt } from "./clock.js";
import { cut } from "./stream.js";
import { COUNTED, LOSSES, clockWords, framesWords } from "./words.js";

const MOST_BYTES = 64 << 20;
const AHEAD = 4; // parts
const AGAIN_MS = 1000;

export class Film {
  constructor(clock, skin, token, surfaceOf, onChange) {
    Object.assign(this, { clock, skin, token, surfaceOf, onChange });
    this.partMs = 1000 * skin.part_s;
    this.end = 1000 * skin.seconds;
    this.begin = 0;
    this.known = true;
    this.parts = new Map(); // number: {frames, bytes}
    this.frames = []; // of all parts here
    this.rows = [];
    this.log = [];
    this.found = [];
    this.losses = [];
    this.share = 0;
    this.why = ""; // why no part comes
    this.busy = false;
    this.surface = null;
  }

  get mode() { return this.clock.mode; }
  get newest() { return this.frames[this.frames.length - 1]; }
  get oldest() { return this.frames[0]; }

  index(t) { return indexAt(this.frames, t); }
  partAt(t) { return Math.min(Math.max(Math.floor(t / this.partMs), 0), this.skin.parts - 1); }
  ready(t) { return this.parts.has(this.partAt(t)); }

  /** Whether a part between two moments is missing. */
  absent(one, other) {
    const last = this.partAt(Math.max(one, other));
    for (let k = this.partAt(Math.min(one, other)); k <= last; k++) if (!this.parts.has(k)) return true;
    return false;
  }

  get shown() {
    const { at } = this.clock, part = this.parts.get(this.partAt(at));
    if (!part || !this.frames.length) return this.last;
    const found = this.frames[this.index(at)], first = part.frames[0]; // earlier parts may be missing
    this.last = first && found.t < first.t && this.absent(found.t, at) ? first : found;
    return this.last;
  }

  /** Fetch the part that is shown, then the next ones and the previous one, one at a time. */
  async fetch() {
    if (this.busy) return;
    const here = this.partAt(this.clock.at), near = [here];
    for (let k = 1; k <= AHEAD; k++) near.push(here + k);
    near.push(here - 1);
    const number = near.find((one) => one >= 0 && one < this.skin.parts && !this.parts.has(one));
    if (number === undefined) return;
    this.busy = true;
    try {
      const headers = this.token ? { Authorization: `Bearer ${this.token}` } : {};
      const answer = await fetch(`part/${number}`, { headers, cache: "no-store" });
      if (!answer.ok) throw new Error((await answer.text()).trim());
      this.put(number, new Uint8Array(await answer.arrayBuffer()));
      this.why = "";
    } catch (error) {
      this.why = error instanceof TypeError ? "" : error.message; // the stream reports a viewer that does not answer
      await new Promise((done) => setTimeout(done, AGAIN_MS));
    } finally {
      this.busy = false;
      this.onChange();
    }
  }

  put(number, bytes) {
    const frames = [];
    let surface = null;
    for (const { head, body } of cut(bytes).found) {
      if (head.kind === "surface") {
        const cloud = new Float32Array(body.buffer);
        const same = this.surface?.revision === head.revision;
        this.surface = surface = same ? this.surface : this.surfaceOf(head.revision, head.shape, cloud);
      } else if (head.kind === "frame") {
        frames.push({ t: head.t_ms, head, map: body, surface: head.cloud ? surface : null });
      }
    }
    this.parts.set(number, { frames, bytes: bytes.length });
    this.forget();
    const order = [...this.parts.keys()].sort((a, b) => a - b);
    this.frames = order.flatMap((one) => this.parts.get(one).frames);
  }

  /** Drop the parts that are farthest away. */
  forget() {
    const here = this.partAt(this.clock.at);
    let bytes = [...this.parts.values()].reduce((sum, part) => sum + part.bytes, 0);
    const far = [...this.parts.keys()].sort((a, b) => Math.abs(b - here) - Math.abs(a - here));
    for (const number of far) {
      if (bytes <= MOST_BYTES || this.parts.size <= AHEAD + 2) return;
      bytes -= this.parts.get(number).bytes;
      this.parts.delete(number);
    }
  }

  takeOverview(head) {
    this.share = head.share;
    this.rowMs = 1000 * head.row_s;
    this.rows = head.rows.map((row) => ({ t: 1000 * row.t, head: row }));
    const half = this.rowMs / 2;
    this.losses = this.rows.map(({ t, head: { losses, lost_ms } }) =>
      ({ begin: t - half, end: t + half, counts: losses, first: lost_ms }));
    const touched = head.touched.map(([begin, end]) => ({ kind: "touched", begin, end }));
    const lost = this.losses.filter(({ counts }) => LOSSES.some(([name]) => counts[name]));
    const events = head.events.map(([t, text]) => ({ kind: "event", begin: t, end: t, text }));
    this.found = [...touched, ...lost.map(({ first, end }) => ({ kind: "lost", begin: first, end })), ...events];
    this.log = [
      ...touched.map(({ begin, end }) => ({ t: begin, text: touchedWords(end - begin) })),
      ...events.map(({ begin, text }) => ({ t: begin, text })),
      ...lost.flatMap(({ first, counts }) => Object.entries(COUNTED).filter(([name]) => counts[name])
        .map(([name, words]) => ({ t: first, text: framesWords(counts[name], words) }))),
    ].sort((a, b) => a.t - b.t);
  }

  /** What strips show: the whole recording. */
  window() {
    const labels = [clockWords(0), clockWords(this.end / 2), clockWords(this.end)];
    return {
      begin: 0, end: this.end, frames: this.rows, gap: Math.max(3 * this.rowMs, 1500), losses: this.losses, labels,
      level: (row) => row.head.peak, least: 1, words: "Peak of the map",
    };
  }

  when(t) { return clockWords(t); }

  marks() { return this.found; }
}

const touchedWords = (ms) => (ms < 50 ? "Touched for a moment" : `Touched for ${(ms / 1000).toFixed(1)} s`);
