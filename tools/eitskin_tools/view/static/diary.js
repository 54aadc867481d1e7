// What happened, from one frame shown to the next. Frames between them were not seen: what they counted and began is
// told by what is different now, so that nothing that lasts is missed.

import { COUNTED, eventWords, framesWords } from "./words.js";

const ENDED_MS = 500; // a touch that was not listed for so long
const TOGETHER_MS = 3000; // losses within it are one entry
const TOLD_OTHERWISE = new Set(["lost", "overrun", "cloud"]);

export class Diary {
  constructor(log) {
    this.log = log;
    this.touches = new Map(); // id: when it was seen last
    this.highest = 0;
  }

  note(t, head, before, eventsComeApart) {
    if (before && before.run !== head.run) {
      this.say(t, "The runtime started anew");
      this.touches.clear();
      this.highest = 0;
    }
    if (before && before.run === head.run) this.count(t, head.counts, before.counts);
    if (!eventsComeApart) for (const code of head.events) this.event(t, code);
    for (const [kind, id, other] of head.touch_events) {
      if (kind === "merged" && this.touches.delete(id)) this.say(t, `Touch ${id} became one with ${other}`);
    }
    for (const { id, parent } of head.touches) {
      if (id > this.highest) this.say(t, parent ? `Touch ${id} split from ${parent}` : `Touch ${id} began`);
      this.highest = Math.max(this.highest, id);
      this.touches.set(id, t);
    }
    for (const [id, seen] of this.touches) {
      if (t - seen < ENDED_MS) continue;
      this.touches.delete(id);
      this.say(t, `Touch ${id} ended`);
    }
  }

  event(t, code) {
    if (!TOLD_OTHERWISE.has(code)) this.say(t, eventWords(code), true);
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
