// The page: takes messages in, keeps the last two minutes, and draws when something has changed.

import { Camera } from "./camera.js";
import { fit } from "./canvas.js";
import { FlatMap } from "./flat.js";
import { History } from "./history.js";
import { drawOverlay } from "./overlay.js";
import * as panel from "./panel.js";
import { Scene } from "./scene.js";
import { follow } from "./stream.js";
import * as strips from "./strips.js";
import { Surface, flatCloud } from "./surface.js";
import { currentTheme, listen, wearTheme } from "./controls.js";
import { Diary } from "./diary.js";

const GONE = "The viewer has ended, or cannot be reached. Start 'eitskin view' again; this page goes on by itself.";
const SLOW_MS = 200; // strips and lists, five times a second
const $ = (id) => document.getElementById(id);

const history = new History();
const scene = new Scene($("scene"));
const diary = new Diary(history.log);
const flat = new FlatMap($("flat"));
const camera = new Camera($("scene"), () => { page.changed = true; });
const page = {
  skin: null, flatSurface: null, surface: null, status: null, state: null, gone: null, changed: true,
  slowAt: 0, at: performance.now(), drawings: 0,
};
if (!scene.gl) $("no-webgl").hidden = false;
panel.makeStageLegend();

function take(head, body) {
  page.gone = null;
  page.changed = true;
  if (head.kind === "skin") takeSkin(head);
  else if (head.kind === "surface") takeSurface(head, body);
  else if (head.kind === "frame") takeFrame(head, body);
  else if (head.kind === "state") takeState(head);
  else if (head.kind === "status") takeStatus(head);
}

function takeSkin(skin) {
  page.skin = skin;
  const palette = new Uint8ClampedArray(1024), levels = skin.palette;
  for (let i = 0; i < 256; i++) {
    const at = (i / 255) * (levels.length - 1), k = Math.min(Math.floor(at), levels.length - 2), share = at - k;
    for (let c = 0; c < 3; c++) palette[4 * i + c] = levels[k][c] * (1 - share) + levels[k + 1][c] * share;
    palette[4 * i + 3] = 255;
  }
  flat.setColours(palette);
  if (scene.gl) scene.setColours(new Uint8Array(palette.buffer));
  $("bar").getContext("2d").putImageData(new ImageData(palette, 256, 1), 0, 0);
  const [rows, columns] = skin.shape;
  page.flatSurface = surfaceOf(0, skin.shape, flatCloud(rows, columns, skin.size_mm));
  page.surface = null;
  $("flat-note").textContent = `${skin.size_mm[0]} × ${skin.size_mm[1]} mm, ${columns} × ${rows} pixels`;
}

function surfaceOf(revision, [rows, columns], cloud) {
  return new Surface(revision, cloud, rows, columns, page.skin.size_mm, page.skin.thickness_mm);
}

function takeFrame(head, body) {
  const before = history.newest;
  const frame = { t: head.t_ms, head, map: body, surface: surfaceFor(head) };
  history.add(frame);
  diary.note(frame.t, head, before?.head, page.state?.run === head.run);
}

function takeStatus(head) {
  const before = page.status;
  page.status = head;
  const t = history.newest?.t ?? 0;
  if (head.recording && head.recording !== before?.recording) diary.say(t, `Recording to ${head.recording}`);
  if (head.recorder && head.recorder !== before?.recorder) diary.say(t, head.recorder);
}

function takeSurface(head, body) {
  page.surface = surfaceOf(head.revision, head.shape, new Float32Array(body.buffer));
  page.surface.run = head.run;
}

/** What happened since the message before, at all frames, those between two pictures too. */
function takeState(head) {
  const before = page.state;
  page.state = head;
  if (before?.run !== head.run || before.n >= head.n) return;
  for (const code of head.events) diary.event(history.newest?.t ?? head.t_ms, code);
}

/** The surface that a frame is drawn on: that in use, the one before until it has come, or none. */
function surfaceFor(head) {
  const { surface } = page;
  if (!head.cloud) return page.flatSurface;
  return surface && surface.run === head.run ? surface : page.flatSurface;
}

/** Frames a second that the runtime publishes, over the last second. */
function rateAt(frame) {
  const before = history.frames[history.index(frame.t - 1000)];
  const seconds = (frame.t - before.t) / 1000;
  return seconds > 0.2 && before.head.run === frame.head.run ? (frame.head.n - before.head.n) / seconds : 0;
}

function drawState(shown) {
  const silent = page.status?.state === "silent";
  const [state, text] = page.gone !== null ? ["gone", "Viewer not reachable"]
    : history.mode !== "live" ? ["paused", history.mode === "playing" ? "Playing" : "Paused"]
    : silent ? ["silent", "No frames"]
      : shown ? ["live", page.skin?.file ? "Recording" : "Live"] : ["waiting", "Waiting"];
  $("state").dataset.state = state;
  if ($("state-text").textContent !== text) $("state-text").textContent = text;
  const said = page.gone !== null ? page.gone || GONE
    : page.status?.text ? `${page.status.text}${silent ? ". This page goes on by itself when frames come." : ""}` : "";
  panel.drawRecord(page.status);
  $("notice").hidden = !said;
  if ($("notice").textContent !== said) $("notice").textContent = said;
}

function drawSlow(shown) {
  strips.drawTouches($("strip-touches"), history);
  strips.drawLatency($("strip-latency"), history);
  strips.drawLosses($("strip-losses"), history);
  strips.drawDrift($("strip-drift"), history);
  if (!shown) return;
  panel.drawFacts(shown, rateAt(shown));
  panel.drawNow(shown);
  panel.drawSkipped(history, shown);
  panel.drawLog(history, shown);
}

function draw(now) {
  if (history.advance(now - page.at)) page.changed = true;
  page.at = now;
  if (page.changed && page.skin) {
    page.changed = false;
    const shown = history.shown, surface = shown?.surface ?? page.flatSurface;
    drawState(shown);
    if (fit($("scene"))) {
      const [rows, columns] = page.skin.shape, map = shown?.map ?? new Uint8Array(rows * columns);
      const shape = shown?.head.shape ?? page.skin.shape, dark = currentTheme() === "dark";
      const matrix = scene.draw(camera, surface, map, shape, page.skin.outline === "disc", dark);
      page.project = drawOverlay($("overlay"), page.skin, shown, surface, camera, matrix);
    }
    flat.draw(page.skin, shown);
    panel.drawTouchTable(shown);
    panel.drawElectrodes(shown, page.skin.electrodes.length);
    $("surface-note").textContent = surface.revision ? `cloud ${surface.revision}`
      : shown?.head.cloud ? `cloud ${shown.head.cloud} is in use; drawn flat` : "flat: no cloud in use";
    if (shown) panel.drawTime(history);
    if (now - page.slowAt >= SLOW_MS || history.mode !== "live") {
      page.slowAt = now;
      drawSlow(shown);
    }
    page.drawings++;
  }
  requestAnimationFrame(draw);
}

const token = new URLSearchParams(location.hash.slice(1)).get("token") ?? "";
listen(page, history, camera, flat, strips, token);
new ResizeObserver(() => { page.changed = true; page.slowAt = 0; }).observe(document.body);
wearTheme();
requestAnimationFrame(draw);
follow(token, take, (why) => { page.gone = why; page.changed = true; if (!page.skin) drawState(null); });
window.eitskin = { page, history, camera, flat }; // for the console
