// What the page says for the codes of a frame; a code that is not listed becomes readable text.

const SKIPPED = {
  "inference:untouched": "No map computed: nothing touches",
  "inference:unchanged": "Last map kept: only noise changed",
  "inference:idle": "No map computed: few electrodes scanned",
  "acquisition:idle": "Few electrodes scanned while nothing touches",
  "map:region": "Only a part of the map computed",
  "map:unchanged": "Map not sent again: it is unchanged",
  "map:untouched": "Untouched, confirmed by a map",
  "geometry:cloud_unchanged": "Surface kept: no new cloud",
};

const EVENTS = {
  lost: "Frames were lost on the wire",
  cloud: "A new surface is in use",
  overrun: "A frame exceeded its time budget",
  device_reset: "The device restarted",
  recovered: "The connection to the device was restored",
  saturated: "A voltage exceeded the converter's range",
  reference: "A new reference is in use",
  idle: "Idle: the device scans few electrodes",
  awake: "Awake: the device scans all electrodes again",
  gate_overruled: "The map shows a touch that the quick check missed",
  "electrodes:unclear": "The voltages fit neither a sheet nor the failure of one electrode",
  "drift:uneven": "The untouched voltages have drifted unevenly",
  "verifier:starting": "The verifier is starting",
  "verifier:preparing": "The verifier is computing its model of the surface",
  "verifier:ready": "The verifier is ready and checks frames",
  "verifier:waiting": "The verifier stopped and will restart; frames are not checked",
  "verifier:failed": "The verifier failed; frames are not checked",
  "device:restarting": "The device is restarting",
  "device:configuration_changed": "The device has a new configuration",
  "device:rolled_back": "The device returned to its previous configuration",
  "device:overrun": "The device skipped scans: the line or the front end is too slow",
  "device:front_end_failed": "The device's front end does not answer",
};

const WITHHELD = {
  malformed: "it is not a frame of this device",
  duplicate: "its number was used before",
  configuration: "the device made it under another configuration",
  partial: "it covers few electrodes",
  implausible: "its values are impossible",
  no_signal: "its voltages are almost zero",
  stuck: "the converter may be stuck",
  frozen: "it repeats an earlier frame exactly",
  stale: "a newer frame was waiting",
};

const ELECTRODE = { "not reciprocal": "inconsistent", excluded: "switched off" };
const REPAIR = { imputed: "estimated", rearranged: "reordered" };

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

function readable(code) {
  const text = code.replaceAll("_", " ").replaceAll(":", ": ");
  return text.charAt(0).toUpperCase() + text.slice(1);
}

export const skippedWords = (code) => SKIPPED[code] ?? readable(code);
export const electrodeWords = (state) => ELECTRODE[state] ?? state;
export const repairWords = (repair) => REPAIR[repair] ?? repair ?? "";

export function eventWords(code) {
  const [kind, name, state, repair] = code.split(":");
  if (EVENTS[code]) return EVENTS[code];
  if (kind === "withheld") return `A frame was withheld: ${WITHHELD[name] ?? readable(name).toLowerCase()}`;
  if (kind === "electrode" && state === "back") return `Electrode ${name} works again`;
  if (kind === "electrode" && state) {
    return `Electrode ${name} is ${electrodeWords(state)}${repair ? `; its voltages are ${repairWords(repair)}` : ""}`;
  }
  if (kind === "drift") return `Drift of ${name.replace("-", "−").replace("%", " %")}, or a long touch`;
  return readable(code);
}

const VALUES = { area: "touched share of a pixel", units: "probability that a unit is touched" };

/** What the map's values mean; labels say what the bundle was trained on, if the runtime says so. */
export function valueWords(solver, labels) {
  return solver === "tikhonov" ? "relative: the largest value is 1" : VALUES[labels] ?? "touched share, or probability";
}
