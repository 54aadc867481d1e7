// Four strips of a history or a film: touches, time by stage, losses, drift.

import { FONT, inks, paper } from "./canvas.js";
import { LOSSES, STAGES } from "./words.js";

const PAD = { left: 34, right: 2, top: 7, bottom: 15 };

export function timeAt(canvas, event, history) {
  const { left, width } = canvas.getBoundingClientRect(), { begin, end } = history.window(width);
  const share = (event.clientX - left - PAD.left) / (width - PAD.left - PAD.right);
  return begin + (end - begin) * Math.min(Math.max(share, 0), 1);
}

class Strip {
  constructor(canvas, history, least) {
    const sheet = paper(canvas);
    this.ok = Boolean(sheet);
    if (!sheet) return;
    Object.assign(this, sheet, history.window(sheet.width));
    Object.assign(this, { ink: inks(), history, least: least ?? this.least });
  }

  scale(high, low = 0) {
    const over = nice(Math.max(high, this.least));
    this.low = low < 0 ? -nice(Math.max(-low, this.least)) : 0;
    this.high = over;
    const { pen, ink, width, height } = this;
    pen.font = FONT;
    pen.fillStyle = ink.muted;
    pen.textAlign = "right";
    pen.textBaseline = "middle";
    pen.strokeStyle = ink.line;
    pen.lineWidth = 1;
    pen.beginPath();
    for (const value of new Set([this.low, 0, this.high])) {
      const y = Math.round(this.y(value)) + 0.5;
      pen.moveTo(PAD.left, y);
      pen.lineTo(width - PAD.right, y);
      pen.fillText(label(value), PAD.left - 4, y);
    }
    pen.stroke();
    pen.textBaseline = "bottom";
    pen.textAlign = "left";
    pen.fillText(this.labels[0], PAD.left, height + 1);
    pen.textAlign = "center";
    pen.fillText(this.labels[1], PAD.left + (width - PAD.left - PAD.right) / 2, height + 1);
    pen.textAlign = "right";
    pen.fillText(this.labels[2], width - PAD.right, height + 1);
  }

  x(t) {
    return PAD.left + ((t - this.begin) / Math.max(this.end - this.begin, 1)) * (this.width - PAD.left - PAD.right);
  }
  y(value) {
    const share = (Math.min(value, this.high) - this.low) / (this.high - this.low);
    return this.height - PAD.bottom - share * (this.height - PAD.top - PAD.bottom);
  }

  /** Fill between two values of each frame, except where a value is null or time has a gap. */
  band(below, above, fill, alpha = 1) {
    const { pen } = this;
    pen.fillStyle = fill;
    pen.globalAlpha = alpha;
    for (const run of this.runs(above)) {
      pen.beginPath();
      for (const frame of run) pen.lineTo(this.x(frame.t), this.y(above(frame)));
      for (const frame of [...run].reverse()) pen.lineTo(this.x(frame.t), this.y(below(frame)));
      pen.fill();
    }
    pen.globalAlpha = 1;
  }

  line(value, colour) {
    const { pen } = this;
    pen.strokeStyle = colour;
    pen.lineWidth = 1.5;
    pen.lineJoin = "round";
    for (const run of this.runs(value)) {
      pen.beginPath();
      for (const frame of run) pen.lineTo(this.x(frame.t), this.y(value(frame)));
      pen.stroke();
    }
  }

  runs(value) {
    const found = [];
    let run = [];
    for (const frame of this.frames) {
      const ends = run.length && frame.t - run[run.length - 1].t > this.gap;
      if (ends || value(frame) === null) {
        if (run.length) found.push(run);
        run = [];
      }
      if (value(frame) !== null && frame.t >= this.begin) run.push(frame);
    }
    if (run.length) found.push(run);
    return found;
  }

  cursor() {
    if (this.history.mode === "live" || !this.history.shown) return;
    const { pen, ink } = this, x = this.x(this.history.clock.at);
    if (x < PAD.left) return;
    pen.strokeStyle = ink.accent;
    pen.lineWidth = 1.5;
    pen.beginPath();
    pen.moveTo(x, PAD.top - 4);
    pen.lineTo(x, this.height - PAD.bottom);
    pen.stroke();
  }
}

export function drawTouches(canvas, history) {
  const strip = new Strip(canvas, history);
  if (!strip.ok) return;
  strip.scale(Math.max(0, ...strip.frames.map(strip.level)));
  strip.band(() => 0, strip.level, strip.ink.s1, 0.25);
  strip.line(strip.level, strip.ink.s1);
  strip.cursor();
}

export function drawLatency(canvas, history) {
  const strip = new Strip(canvas, history, 0.2);
  if (!strip.ok) return;
  const sums = new Map();
  for (const frame of strip.frames) {
    let sum = 0;
    sums.set(frame, [0, ...frame.head.stages_us.map((us) => (sum += us / 1000))]);
  }
  const totals = [...sums.values()].map((stack) => stack[STAGES.length]).sort((a, b) => a - b);
  strip.scale(1.1 * (totals[Math.floor(0.98 * (totals.length - 1))] ?? 0));
  STAGES.forEach((_, k) => strip.band((f) => sums.get(f)[k], (f) => sums.get(f)[k + 1], strip.ink[`s${k + 1}`], 0.9));
  strip.cursor();
}

export function drawLosses(canvas, history) {
  const strip = new Strip(canvas, history, 4);
  if (!strip.ok) return;
  const { pen, ink, losses } = strip;
  const sum = (counts) => LOSSES.reduce((all, [name]) => all + (counts[name] ?? 0), 0);
  strip.scale(Math.max(0, ...losses.map(({ counts }) => sum(counts))));
  const inksOf = { lost: ink.s4, corrupt: ink.s5, withheld: ink.s1, overrun: ink.s6 };
  for (const { begin, end, counts } of losses) {
    const left = Math.max(strip.x(begin), PAD.left), wide = Math.max(strip.x(end) - left - 1, 1.5);
    let from = 0;
    for (const [name] of LOSSES) {
      if (!counts[name]) continue;
      pen.fillStyle = inksOf[name];
      pen.fillRect(left, strip.y(from + counts[name]), wide, strip.y(from) - strip.y(from + counts[name]));
      from += counts[name];
    }
  }
  strip.cursor();
}

export function drawDrift(canvas, history) {
  const strip = new Strip(canvas, history, 1);
  if (!strip.ok) return;
  const value = (frame) => frame.head.drift[0], sd = (frame) => frame.head.drift[1] ?? 0;
  const known = strip.frames.filter((frame) => value(frame) !== null);
  const tops = known.map((f) => value(f) + sd(f)), feet = known.map((f) => value(f) - sd(f));
  strip.scale(Math.max(0, ...tops), Math.min(-0.01, ...feet));
  strip.band((f) => value(f) - sd(f), (f) => (value(f) === null ? null : value(f) + sd(f)), strip.ink.s3, 0.25);
  strip.line(value, strip.ink.s3);
  strip.cursor();
}

/** The next of 1, 2, 5 times a power of ten. */
function nice(value) {
  const power = 10 ** Math.floor(Math.log10(value));
  return power * ([1, 2, 5, 10].find((step) => step * power >= value * 0.999) ?? 10);
}

function label(value) {
  return String(Number(value.toPrecision(2))).replace("-", "−");
}

const ROWS = { touched: [0, 5, "s1"], event: [6, 4, "s6"], lost: [6, 4, "s4"] }; // top, height, colour
const THUMB = 16; // the bar's button is as wide, so that its middle never reaches the ends

export function drawMarks(canvas, clock, track) {
  const sheet = paper(canvas);
  if (!sheet || !clock.known) return;
  const { pen, width } = sheet, ink = inks(), { begin, end } = clock, room = width - THUMB;
  const x = (t) => THUMB / 2 + ((t - begin) / Math.max(end - begin, 1)) * room;
  const share = track.share ?? 1;
  pen.fillStyle = ink.line;
  pen.fillRect(THUMB / 2, 0, room * share, 5); // the part that is known
  for (const kind of ["touched", "event", "lost"]) {
    const [top, high, colour] = ROWS[kind];
    pen.fillStyle = ink[colour];
    for (const mark of track.marks()) {
      if (mark.kind !== kind) continue;
      const left = x(mark.begin);
      pen.fillRect(left, top, Math.max(x(mark.end) - left, 1.5), high);
    }
  }
}
