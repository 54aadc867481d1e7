// Words of the page. Events, electrodes and saved computation arrive in words.

export const STAGES = ["decode", "normalise", "touched?", "map", "pack", "publish"];
export const LOSSES = [["lost", "lost"], ["corrupt", "corrupt"], ["withheld", "withheld"], ["overrun", "late"]];
export const COUNTED = { lost: "lost on the wire", corrupt: "corrupt on the wire", overrun: "over the time budget" };

export const framesWords = (count, words) => `${count} ${count === 1 ? "frame" : "frames"} ${words}`;

/** A moment of a recording: minutes, seconds and tenths, hours where there are any. */
export function clockWords(ms) {
  const tenths = Math.floor(Math.max(ms, 0) / 100), minutes = Math.floor(tenths / 600);
  const hours = Math.floor(minutes / 60);
  const seconds = ((tenths % 600) / 10).toFixed(1).padStart(4, "0");
  return hours ? `${hours}:${String(minutes % 60).padStart(2, "0")}:${seconds}` : `${minutes}:${seconds}`;
}

const VALUES = { area: "touched share of a pixel", units: "probability that a unit is touched" };

/** What the map's values mean; labels say what the bundle was trained on, if the runtime says so. */
export function valueWords(solver, labels) {
  return solver === "tikhonov" ? "relative: the largest value is 1" : VALUES[labels] ?? "touched share, or probability";
}
