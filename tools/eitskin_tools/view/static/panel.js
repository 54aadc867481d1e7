// The texts beside the pictures. A text is only written if it changed, so that selections and screen readers stay.

import { illOf } from "./canvas.js";
import { areaOf } from "./history.js";
import { LOSSES, STAGES, valueWords } from "./words.js";

const $ = (id) => document.getElementById(id);
const say = (node, text) => { if (node.textContent !== text) node.textContent = text; };

/** Make a list have these rows of texts. */
function rows(node, wanted, tag, cell) {
  while (node.children.length > wanted.length) node.lastElementChild.remove();
  wanted.forEach((texts, k) => {
    const row = node.children[k] ?? node.appendChild(document.createElement(tag));
    while (row.children.length > texts.length) row.lastElementChild.remove();
    texts.forEach((text, j) => say(row.children[j] ?? row.appendChild(document.createElement(cell)), text));
  });
}

export function drawFacts(frame, rate, recordedAt) {
  const { head } = frame;
  const facts = [["rate", rate ? `${rate.toFixed(0)} frames/s` : "–"], ["solver", head.solver],
    recordedAt ? ["recorded", recordedAt] : ["age", `${(head.age_us / 1000).toFixed(1)} ms`],
    ["lost since the start", String(head.counts.lost)], ["device", head.serial]];
  const node = $("facts");
  while (node.children.length < facts.length) {
    const pair = node.appendChild(document.createElement("div"));
    pair.append(document.createElement("dt"), document.createElement("dd"));
  }
  facts.forEach(([name, text], k) => {
    say(node.children[k].children[0], name);
    say(node.children[k].children[1], text);
  });
}

export function drawTouchTable(frame, labels) {
  const touches = frame?.head.touches ?? [], more = frame?.head.more ?? 0;
  const words = ({ id, centre: [x, y], area, peak }) => [
    String(id), `${x.toFixed(1)}, ${y.toFixed(1)}`, area.toFixed(0), peak.toFixed(2),
  ];
  rows($("touches"), touches.map(words), "tr", "td");
  $("no-touches").hidden = touches.length > 0;
  say($("no-touches"), frame ? "No touch." : "Unknown.");
  say($("touches-note"), more ? `and ${more} more` : "");
  say($("bar-words"), valueWords(frame?.head.solver, labels));
}

export function drawElectrodes(frame, count) {
  const ill = Object.entries(illOf(frame));
  const list = $("electrodes");
  const words = ill.map(([k, { state, repair }]) =>
    [`${k} is ${state}`, repair ? `rows ${repair}` : ""]);
  rows(list, ill.length ? words : [[frame ? `All ${count} electrodes work.` : "Unknown."]], "li", "span");
  for (const row of list.children) row.firstElementChild.className = ill.length ? "ill" : "";
}

/** The computation saved in the 5 s before a moment, as a share of the frames. */
export function drawSkipped(history, shown) {
  const last = history.index(shown.t), counts = new Map();
  let total = 0;
  for (let k = last; k >= 0 && shown.t - history.frames[k].t < 5000; k--) {
    total++;
    for (const words of history.frames[k].head.skipped) counts.set(words, (counts.get(words) ?? 0) + 1);
  }
  const found = [...counts].sort((a, b) => b[1] - a[1]);
  const shares = found.map(([words, n]) => [words, `${Math.round((100 * n) / total)} %`]);
  rows($("skipped"), found.length ? shares : [["Nothing."]], "li", "span");
}

export function drawLog(history, shown) {
  const seen = history.log.filter((entry) => entry.t <= shown.t + 50).slice(-40).reverse();
  const words = seen.map((entry) => [entry.text, history.when(entry.t)]);
  rows($("log"), seen.length ? words : [["No events yet."]], "li", "span");
  seen.forEach((entry, k) => { $("log").children[k].dataset.t = entry.t; });
}

/** The numbers beside the charts; losses are those of the chart. */
export function drawNow(frame, { words, losses }) {
  say($("touch-words"), words);
  const { head } = frame, total = head.stages_us.reduce((a, b) => a + b, 0) / 1000, n = head.touches.length;
  const sums = LOSSES.map(([name, word]) => [losses.reduce((sum, { counts }) => sum + (counts[name] ?? 0), 0), word]);
  say($("touch-now"), `${n} ${n === 1 ? "touch" : "touches"}, ${areaOf(frame).toFixed(0)} mm²`);
  say($("latency-now"), `${total.toFixed(2)} ms`);
  const counted = sums.filter(([count]) => count).map(([count, word]) => `${count} ${word}`).join(", ");
  say($("losses-now"), counted || "none");
  const [drift, sd] = head.drift, unknown = head.touched ? "unknown while touched" : "unknown";
  say($("drift-now"), drift === null ? unknown : `${signed(drift)}${sd === null ? "" : ` ± ${sd.toFixed(1)}`} %`);
}

export function drawRecord(status) {
  const button = $("record"), on = Boolean(status?.recording);
  button.hidden = !status?.can_record;
  button.setAttribute("aria-pressed", String(on));
  button.title = on ? `Stop recording ${status.recording} (R)` : "Record what is measured to a file (R)";
  say($("record-text"), on ? "Stop recording" : "Record");
}

export function makeStageLegend() {
  STAGES.forEach((stage, k) => {
    const entry = $("stages").appendChild(document.createElement("span"));
    const mark = entry.appendChild(document.createElement("i"));
    mark.style.background = `var(--s${k + 1})`;
    entry.append(stage);
  });
}

export function drawTime(clock, track) {
  const { begin, end, film } = clock, scrub = $("scrub"), at = clock.mode === "live" ? end : clock.at;
  const range = Math.round(end - begin), value = Math.round(at - begin);
  const text = clock.mode === "live" ? "now" : film ? `${track.when(at)} of ${track.when(end)}` : track.when(at);
  scrub.max = String(range);
  if (Number(scrub.value) !== value) scrub.value = String(value);
  if (scrub.getAttribute("aria-valuetext") !== text) scrub.setAttribute("aria-valuetext", text);
  say($("when"), text);
  say($("pause"), clock.mode === "paused" ? "Play" : "Pause");
  $("live").hidden = Boolean(film);
  $("live").disabled = clock.mode === "live";
}

/** The skins by name, with what each feels; hidden if there is only one. */
export function drawSkins(skins, selected, choose) {
  const list = $("skins");
  list.hidden = skins.length < 2;
  if (list.hidden) return;
  while (list.children.length < skins.length) {
    const button = list.appendChild(document.createElement("button"));
    const of = list.children.length - 1;
    button.type = "button";
    button.append(document.createElement("i"), document.createElement("b"), document.createElement("span"));
    button.addEventListener("click", () => choose(of));
  }
  skins.forEach((skin, of) => {
    const button = list.children[of], n = skin.history.shown?.head.touches.length ?? 0;
    button.setAttribute("aria-pressed", String(of === selected));
    button.dataset.state = skin.silent ? "silent" : n ? "touched" : "live";
    say(button.children[1], skin.name);
    say(button.children[2], skin.silent ? "no frames" : n ? `${n} ${n === 1 ? "touch" : "touches"}` : "untouched");
  });
}

const signed = (value) => (value < 0 ? `−${(-value).toFixed(1)}` : `+${value.toFixed(1)}`);
