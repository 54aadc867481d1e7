// The moment that all skins show: the present, or a past moment, still or playing.

const SMALL_MS = 5; // a step to where nothing is loaded

export class Clock {
  constructor() {
    this.tracks = []; // a history for each skin, or a film
    this.mode = "live"; // or paused, playing
    this.at = 0; // ms, while not live
    this.film = null;
  }

  get begin() { return Math.min(...this.tracks.filter((one) => one.known).map((one) => one.begin)); }
  get end() { return Math.max(...this.tracks.filter((one) => one.known).map((one) => one.end)); }
  get known() { return this.tracks.some((one) => one.known); }

  /** Show a recording, which plays from its beginning. */
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

  /** Go to the previous or next frame of a track. */
  step(track, by) {
    const { frames } = track;
    if (!frames.length) return;
    const from = this.mode === "live" ? frames.length - 1 : track.index(this.at);
    const to = Math.min(Math.max(from + by, 0), frames.length - 1);
    const there = !this.film?.absent(frames[from].t, frames[to].t);
    this.go(there && to !== from ? frames[to].t : this.at + (this.film ? by * SMALL_MS : 0));
  }

  /** Go to the previous or next mark. */
  leap(track, by) {
    const here = this.mode === "live" ? this.end : this.at;
    const times = [...new Set(track.marks().map((mark) => mark.begin))].sort((a, b) => a - b);
    const found = by > 0 ? times.find((t) => t > here + 1) : times.findLast((t) => t < here - 1);
    if (found !== undefined) this.go(found);
  }

  /** Advance while playing; a film waits for parts that are not loaded. */
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

/** Frames at a regular step, and the last, so that a strip has about one for each pixel of its width. */
export function thinned(frames, width) {
  const every = Math.max(1, Math.floor(frames.length / Math.max(width, 100)));
  return frames.filter((_, k) => k % every === 0 || k === frames.length - 1);
}
