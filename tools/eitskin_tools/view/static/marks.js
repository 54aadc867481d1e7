// Marks on the bar: where it was touched, what was lost, what happened.

import { inks, paper } from "./canvas.js";

const ROWS = { touched: [0, 5, "s1"], event: [6, 4, "s6"], lost: [6, 4, "s4"] }; // top, height, colour
const THUMB = 16; // the bar's button is as wide, so that its middle never reaches the ends

export function drawMarks(canvas, clock, track) {
  const sheet = paper(canvas);
  if (!sheet || !clock.known) return;
  const { pen, width } = sheet, ink = inks(), { begin, end } = clock, room = width - THUMB;
  const x = (t) => THUMB / 2 + ((t - begin) / Math.max(end - begin, 1)) * room;
  const share = track.share ?? 1;
  pen.fillStyle = ink.line;
  pen.fillRect(THUMB / 2, 0, room * share, 5); // so far it is known
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
