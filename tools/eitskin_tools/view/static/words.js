// Codes of frames in plain words; one that is not listed stands for itself.

const SKIPPED = {
  "inference:untouched": "No map: nothing touches",
  "inference:unchanged": "No new map: only noise changed",
  "inference:idle": "No map: only a few drives scanned",
  "acquisition:idle": "Scanned a few drives only",
  "map:region": "Only some regions computed",
  "map:unchanged": "Map not sent: it is the one before",
  "map:untouched": "Map is 0: the gate was checked and right",
  "geometry:cloud_unchanged": "Surface not evaluated: no new cloud",
};

const EVENTS = {
  device_reset: "The device started anew",
  recovered: "The device was greeted anew after silence",
  saturated: "A row was cut off: too large for the converter",
  reference: "A new reference is in use",
  idle: "Idle: a few drives are scanned",
  awake: "Awake: all drives are scanned again",
  gate_overruled: "The map shows a touch that the gate did not see",
  "electrodes:unclear": "The rows fit no sheet and no single failure",
  "drift:uneven": "The untouched voltages have moved unevenly",
};

const WITHHELD = {
  malformed: "no frame of this device",
  duplicate: "its number was there before",
  configuration: "made under another configuration",
  partial: "a scan of some drives only",
  implausible: "values beyond all measure",
  no_signal: "no voltage worth the name",
  stuck: "rows are alike as no sheet's are",
  frozen: "repeats a frame before bit by bit",
  stale: "waited while a newer one came",
};

const VERIFIER = {
  starting: "The verifier starts",
  preparing: "The verifier models the surface in use",
  ready: "The verifier is ready: frames are verified",
  waiting: "The verifier ended, and will be started again",
  failed: "The verifier has given up: frames go out unverified",
};

export const STAGES = ["decode", "normalise", "gate", "infer", "pack", "publish"];
export const LOSSES = [["lost", "lost"], ["corrupt", "corrupt"], ["withheld", "withheld"], ["overrun", "late"]];
export const COUNTED = { lost: "lost on the wire", corrupt: "corrupt on the wire", overrun: "over their time budget" };

export const framesWords = (count, words) => `${count} ${count === 1 ? "frame" : "frames"} ${words}`;

/** A moment of a recording: minutes, seconds and tenths, hours where there are any. */
export function clockWords(ms) {
  const tenths = Math.floor(Math.max(ms, 0) / 100), minutes = Math.floor(tenths / 600);
  const hours = Math.floor(minutes / 60);
  const seconds = ((tenths % 600) / 10).toFixed(1).padStart(4, "0");
  return hours ? `${hours}:${String(minutes % 60).padStart(2, "0")}:${seconds}` : `${minutes}:${seconds}`;
}

export const skippedWords = (code) => SKIPPED[code] ?? code;

export function eventWords(code) {
  if (EVENTS[code]) return EVENTS[code];
  const [kind, ...rest] = code.split(":");
  if (kind === "withheld") return `A frame was withheld: ${WITHHELD[rest[0]] ?? rest[0]}`;
  if (kind === "verifier") return VERIFIER[rest[0]] ?? `The verifier is ${rest[0]}`;
  if (kind === "electrode" && rest[1] === "back") return `Electrode ${rest[0]} is used again`;
  if (kind === "electrode") return `Electrode ${rest[0]} is ${rest[1]}${rest[2] ? `; its rows are ${rest[2]}` : ""}`;
  if (kind === "drift") return `All untouched voltages have moved by ${rest[0]}`;
  if (kind === "device") return `The device says: ${rest.join(":").replaceAll("_", " ")}`;
  return code;
}

export function valueWords(solver) {
  return solver === "tikhonov" ? "relative: the largest is 1" : "touched share of a pixel, or probability of a touch";
}
