// The last two minutes of a skin.

import { indexAt, thinned } from "./clock.js";
import { LOSSES } from "./words.js";

const KEEP_MS = 120000;
export const WINDOW_MS = 60000;
const GAP_MS = 1500; // a longer silence stays blank
const APART_MS = 500; // touches that are nearer to each other are one mark

export class History {
  constructor(clock) {
    this.clock = clock;
    this.frames = []; // by time: {t, head, map, surface}
    this.log = []; // {t, text}
  }

  add(frame) {
    const last = this.newest;
    if (last && frame.t < last.t) { // the viewer's machine restarted, and its clock too
      this.frames = [];
      this.log.length = 0;
      this.clock.live();
    }
    this.frames.push(frame);
    const oldest = frame.t - KEEP_MS;
    let gone = 0;
    while (this.frames[gone].t < oldest) gone++;
    if (gone > 64) this.frames.splice(0, gone);
    while (this.log.length && (this.log[0].t < oldest || this.log.length > 200)) this.log.shift();
    if (this.clock.at < this.clock.begin) this.clock.at = this.clock.begin;
  }

  get known() { return this.frames.length > 0; }
  get newest() { return this.frames[this.frames.length - 1]; }
  get oldest() { return this.frames[0]; }
  get begin() { return this.oldest.t; }
  get end() { return this.newest.t; }
  get mode() { return this.clock.mode; }

  index(t) { return indexAt(this.frames, t); }

  get shown() { return this.mode === "live" ? this.newest : this.frames[this.index(this.clock.at)]; }

  /** What strips show: the last minute. */
  window(width) {
    const end = this.clock.known ? this.clock.end : 0, begin = end - WINDOW_MS;
    const since = this.frames.filter((frame) => frame.t >= begin);
    return {
      begin, end, frames: thinned(since, width), gap: GAP_MS, losses: lossesBySecond(since),
      labels: ["−60 s", "−30 s", "now"], level: areaOf, least: 50, words: "Touches, mm²",
    };
  }

  /** When something was, in words. */
  when(t) { return ago(this.clock.end - t); }

  /** The marks of the time bar: {kind, begin, end}. */
  marks() {
    const found = [];
    let touched = null, before = null;
    for (const { t, head } of this.frames) {
      if (head.touched && touched && t - touched.end < APART_MS) touched.end = t;
      else if (head.touched) found.push(touched = { kind: "touched", begin: t, end: t });
      if (before?.run === head.run && LOSSES.some(([name]) => head.counts[name] > before.counts[name])) {
        found.push({ kind: "lost", begin: t, end: t });
      }
      before = head;
    }
    for (const { t, event } of this.log) if (event) found.push({ kind: "event", begin: t, end: t });
    return found;
  }
}

export const areaOf = (frame) => frame.head.touches.reduce((sum, touch) => sum + touch.area, 0);
export const ago = (ms) => (ms < 50 ? "now" : `${(ms / 1000).toFixed(1)} s ago`);

/** The losses of each second: {begin, end, counts}. */
function lossesBySecond(frames) {
  const found = new Map();
  for (let k = 1; k < frames.length; k++) {
    const [before, now] = [frames[k - 1].head, frames[k].head];
    if (before.run !== now.run) continue;
    const second = Math.floor(frames[k].t / 1000), entry = found.get(second) ?? {};
    for (const [name] of LOSSES) {
      const more = now.counts[name] - before.counts[name];
      if (more > 0) entry[name] = (entry[name] ?? 0) + more;
    }
    found.set(second, entry);
  }
  return [...found].map(([second, counts]) => ({ begin: 1000 * second, end: 1000 * (second + 1), counts }));
}
