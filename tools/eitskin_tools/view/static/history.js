// The last two minutes, and which moment of them is shown.

const KEEP_MS = 120000;

export class History {
  constructor() {
    this.frames = []; // by time: {t, head, map, surface}
    this.log = []; // {t, text, kind}
    this.mode = "live"; // or paused, playing
    this.at = 0; // time shown while not live
  }

  add(frame) {
    const last = this.newest;
    if (last && frame.t < last.t) this.clear(); // another machine's clock, or the same one after it was started anew
    this.frames.push(frame);
    const oldest = frame.t - KEEP_MS;
    let gone = 0;
    while (this.frames[gone].t < oldest) gone++;
    if (gone > 64) this.frames.splice(0, gone);
    while (this.log.length && (this.log[0].t < oldest || this.log.length > 200)) this.log.shift();
    if (this.at < this.frames[0].t) this.at = this.frames[0].t;
  }

  clear() {
    this.frames = [];
    this.log.length = 0;
    this.mode = "live";
  }

  get newest() { return this.frames[this.frames.length - 1]; }
  get oldest() { return this.frames[0]; }

  /** Index of the last frame at or before a time. */
  index(t) {
    let low = 0, high = this.frames.length - 1;
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (this.frames[middle].t <= t) low = middle; else high = middle - 1;
    }
    return low;
  }

  get shown() { return this.mode === "live" ? this.newest : this.frames[this.index(this.at)]; }

  pause() {
    if (this.mode === "live" && this.newest) this.at = this.newest.t;
    this.mode = "paused";
  }

  play() { this.mode = this.newest && this.at < this.newest.t ? "playing" : "live"; }

  live() { this.mode = "live"; }

  go(t) {
    if (!this.newest) return;
    this.mode = "paused";
    this.at = Math.min(Math.max(t, this.oldest.t), this.newest.t);
  }

  step(by) {
    if (!this.newest) return;
    const from = this.mode === "live" ? this.frames.length - 1 : this.index(this.at);
    this.go(this.frames[Math.min(Math.max(from + by, 0), this.frames.length - 1)].t);
  }

  /** Let time go on while it is played. */
  advance(ms) {
    if (this.mode !== "playing") return false;
    this.at += ms;
    if (this.at >= this.newest.t) this.mode = "live";
    return true;
  }
}
