// One skin as the page knows it: its description, its frames and its status.

import { Film } from "./film.js";
import { History } from "./history.js";
import { Surface } from "./surface.js";
import { COUNTED, framesWords } from "./words.js";

const ENDED_MS = 500; // a touch that is not listed for this long has ended
const TOGETHER_MS = 3000; // losses within it are one entry

export class Skin {
  constructor(head, cloud, clock, token, onChange) {
    Object.assign(this, { head, clock, of: head.of, name: head.name || head.skin });
    this.flatSurface = this.surfaceOf(0, head.shape, cloud);
    this.surface = null;
    this.status = null;
    this.state = null;
    if (head.file) {
      const surfaceOf = (revision, shape, cloud_mm) => this.surfaceOf(revision, shape, cloud_mm);
      this.history = new Film(clock, head, token, surfaceOf, onChange);
      clock.show(this.history);
    } else {
      this.history = new History(clock);
      this.diary = new Diary(this.history.log);
    }
  }

  surfaceOf(revision, [rows, columns], cloud) {
    return new Surface(revision, cloud, rows, columns, this.head.size_mm, this.head.thickness_mm);
  }

  /** It sends nothing while the page shows the present. */
  get silent() { return this.status?.state === "silent" && this.clock.mode === "live"; }

  get drawn() { return this.history.shown?.surface ?? this.flatSurface; }

  take(head, body) {
    if (head.kind === "surface") {
      this.surface = this.surfaceOf(head.revision, head.shape, new Float32Array(body.buffer));
      this.surface.run = head.run;
    } else if (head.kind === "frame") this.takeFrame(head, body);
    else if (head.kind === "state") this.takeState(head);
    else if (head.kind === "status") this.takeStatus(head);
    else if (head.kind === "overview") this.history.takeOverview(head);
  }

  takeFrame(head, body) {
    const before = this.history.newest;
    const frame = { t: head.t_ms, head, map: body, surface: this.surfaceFor(head) };
    this.history.add(frame);
    this.diary.note(frame.t, head, before?.head, this.state?.run === head.run);
  }

  takeStatus(head) {
    const before = this.status;
    this.status = head;
    if (!this.diary) return;
    const t = this.history.newest?.t ?? 0;
    if (head.recording && head.recording !== before?.recording) this.diary.say(t, `Recording to ${head.recording}`);
    if (head.recorder && head.recorder !== before?.recorder) this.diary.say(t, head.recorder);
  }

  /** The events since the previous message, also of frames that the page did not get. */
  takeState(head) {
    const before = this.state;
    this.state = head;
    if (before?.run !== head.run || before.n >= head.n) return;
    for (const words of head.events) this.diary.say(this.history.newest?.t ?? 0, words, true);
  }

  /** The surface to draw a frame on: the newest that arrived, or the flat sheet. */
  surfaceFor(head) {
    if (!head.cloud) return this.flatSurface;
    return this.surface && this.surface.run === head.run ? this.surface : this.flatSurface;
  }

  /** Frames a second that the runtime publishes, over the last second. */
  rateAt(frame) {
    const before = this.history.frames[this.history.index(frame.t - 1000)];
    const seconds = (frame.t - before.t) / 1000;
    return seconds > 0.2 && before.head.run === frame.head.run ? (frame.head.n - before.head.n) / seconds : 0;
  }
}

/** The box around all surfaces, which the camera shows. */
export function boxOf(surfaces) {
  if (surfaces.length === 1) return surfaces[0];
  const low = [0, 1, 2].map((k) => Math.min(...surfaces.map((one) => one.low[k])));
  const high = [0, 1, 2].map((k) => Math.max(...surfaces.map((one) => one.high[k])));
  return { low, high, centre: low.map((value, k) => (value + high[k]) / 2),
    radius: Math.hypot(...low.map((value, k) => high[k] - value)) / 2 };
}

// The events from one frame of the page to the next. The page skips frames: counts and touches that differ now tell
// what happened between, so that nothing that lasts is missed.
class Diary {
  constructor(log) {
    this.log = log;
    this.touches = new Map(); // id: when it was seen last
    this.highest = 0;
  }

  note(t, head, before, eventsComeApart) {
    if (before && before.run !== head.run) {
      this.say(t, "The runtime restarted");
      this.touches.clear();
      this.highest = 0;
    }
    if (before && before.run === head.run) this.count(t, head.counts, before.counts);
    if (!eventsComeApart) for (const words of head.events) this.say(t, words, true);
    for (const [kind, id, other] of head.touch_events) {
      if (kind === "merged" && this.touches.delete(id)) this.say(t, `Touch ${id} merged into touch ${other}`);
    }
    for (const { id, parent } of head.touches) {
      if (id > this.highest) this.say(t, parent ? `Touch ${id} split from touch ${parent}` : `Touch ${id} began`);
      this.highest = Math.max(this.highest, id);
      this.touches.set(id, t);
    }
    for (const [id, seen] of this.touches) {
      if (t - seen < ENDED_MS) continue;
      this.touches.delete(id);
      this.say(t, `Touch ${id} ended`);
    }
  }

  count(t, now, before) {
    for (const [name, words] of Object.entries(COUNTED)) {
      const more = now[name] - before[name];
      if (more <= 0) continue;
      const last = this.log.findLast((entry) => entry.name === name);
      if (last && t - last.t < TOGETHER_MS) {
        last.count += more;
        last.text = framesWords(last.count, words);
      } else {
        this.log.push({ t, name, count: more, text: framesWords(more, words) });
      }
    }
  }

  say(t, text, event = false) {
    const last = this.log[this.log.length - 1];
    if (last?.text === text && t - last.t < TOGETHER_MS) return;
    this.log.push({ t, text, event });
  }
}
