// Which moment is shown, of all skins alike: now, one that stands still, or one that is played from there.

const SMALL_MS = 5; // a step to where nothing is loaded yet

export class Clock {
  constructor() {
    this.tracks = []; // what has a past: a history for each skin, or a film
    this.mode = "live"; // or paused, playing
    this.at = 0; // ms, while not live
    this.film = null;
  }

  get begin() { return Math.min(...this.tracks.filter((one) => one.known).map((one) => one.begin)); }
  get end() { return Math.max(...this.tracks.filter((one) => one.known).map((one) => one.end)); }
  get known() { return this.tracks.some((one) => one.known); }

  /** Show a recording: there is no now, it plays from its beginning. */
  show(film) {
    Object.assign(this, { film, tracks: [film], mode: "playing", at: 0 });
  }

  pause() {
    if (this.mode === "live" && this.known) this.at = this.end;
    this.mode = "paused";
  }

  play() {
    if (!this.known) return;
    if (this.film && this.at >= this.end) this.at = this.begin;
    this.mode = this.film || this.at < this.end ? "playing" : "live";
  }

  live() { if (!this.film) this.mode = "live"; }

  go(t) {
    if (!this.known) return;
    this.mode = "paused";
    this.at = Math.min(Math.max(t, this.begin), this.end);
  }

  /** One picture of a track back or on. */
  step(track, by) {
    const { frames } = track;
    if (!frames.length) return;
    const from = this.mode === "live" ? frames.length - 1 : track.index(this.at);
    const to = Math.min(Math.max(from + by, 0), frames.length - 1);
    const there = !this.film?.absent(frames[from].t, frames[to].t);
    this.go(there && to !== from ? frames[to].t : this.at + (this.film ? by * SMALL_MS : 0));
  }

  /** To the next mark, or the one before. */
  leap(track, by) {
    const here = this.mode === "live" ? this.end : this.at;
    const times = [...new Set(track.marks().map((mark) => mark.begin))].sort((a, b) => a - b);
    const found = by > 0 ? times.find((t) => t > here + 1) : times.findLast((t) => t < here - 1);
    if (found !== undefined) this.go(found);
  }

  /** Let time go on while it is played; a film waits for what is not there yet. */
  advance(ms) {
    if (this.mode !== "playing") return false;
    if (this.film && !this.film.ready(this.at)) return false;
    this.at += Math.min(ms, 250);
    if (this.at >= this.end) {
      this.at = this.end;
      this.mode = this.film ? "paused" : "live";
    }
    return true;
  }
}

/** Index of the last frame at or before a time, of frames in order. */
export function indexAt(frames, t) {
  let low = 0, high = frames.length - 1;
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (frames[middle].t <= t) low = middle; else high = middle - 1;
  }
  return low;
}

/** Every so manieth frame, and the last, so that a strip of some width has one a pixel. */
export function thinned(frames, width) {
  const every = Math.max(1, Math.floor(frames.length / Math.max(width, 100)));
  return frames.filter((_, k) => k % every === 0 || k === frames.length - 1);
}
