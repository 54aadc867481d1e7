// The page: receives messages, keeps the state of each skin, and draws when something has changed.

import { Camera } from "./camera.js";
import { fit } from "./canvas.js";
import { Clock } from "./clock.js";
import { currentTheme, listen, wearTheme } from "./controls.js";
import { FlatMap } from "./flat.js";
import { drawOverlay, skinUnder } from "./overlay.js";
import * as panel from "./panel.js";
import { Scene } from "./scene.js";
import { Skin, boxOf } from "./skins.js";
import { follow } from "./stream.js";
import * as strips from "./strips.js";

const GONE = "The viewer has stopped or cannot be reached. If you start it again, open the address that it prints.";
const SLOW_MS = 200; // strips and lists, five times a second
const $ = (id) => document.getElementById(id);

const token = new URLSearchParams(location.hash.slice(1)).get("token") ?? "";
const clock = new Clock();
const scene = new Scene($("scene"));
const flat = new FlatMap($("flat"));
const page = {
  skins: [], selected: 0, gone: null, changed: true, slowAt: 0, at: performance.now(), drawings: 0,
  get one() { return this.skins[this.selected] ?? null; },
  get skin() { return this.one?.head ?? null; },
  get history() { return this.one?.history ?? null; },
  get status() { return this.one?.status ?? null; },
  get surface() { return this.one?.surface ?? null; },
  choose(of) {
    this.selected = (of + this.skins.length) % Math.max(this.skins.length, 1);
    redraw();
  },
};
const redraw = () => { page.changed = true; page.slowAt = 0; };
const camera = new Camera($("scene"), () => { page.changed = true; }, (x, y) => {
  const found = skinUnder(page.skins, page.project, x, y);
  if (found !== null) page.choose(found);
});
if (!scene.gl) $("no-webgl").hidden = false;
panel.makeStageLegend();

function take(head, body) {
  page.gone = null;
  page.changed = true;
  if (head.kind === "skin") takeSkin(head, body);
  else page.skins[head.of]?.take(head, body);
}

/** The stream begins with the skins; a restarted viewer may have other ones. */
function takeSkin(head, body) {
  const before = page.skins[head.of]?.head, same = (key) => JSON.stringify(before?.[key]) === JSON.stringify(head[key]);
  if (before && ["file", "seconds", "shape", "size_mm", "name", "skins"].every(same)) return; // its past is kept
  const palette = new Uint8ClampedArray(1024), levels = head.palette;
  for (let i = 0; i < 256; i++) {
    const at = (i / 255) * (levels.length - 1), k = Math.min(Math.floor(at), levels.length - 2), share = at - k;
    for (let c = 0; c < 3; c++) palette[4 * i + c] = levels[k][c] * (1 - share) + levels[k + 1][c] * share;
    palette[4 * i + 3] = 255;
  }
  flat.setColours(palette);
  if (scene.gl) scene.setColours(new Uint8Array(palette.buffer));
  $("bar").getContext("2d").putImageData(new ImageData(palette, 256, 1), 0, 0);
  page.skins.length = Math.min(page.skins.length, head.skins);
  page.skins[head.of] = new Skin(head, new Float32Array(body.buffer), clock, token, redraw);
  page.selected = Math.min(page.selected, page.skins.length - 1);
  if (head.file) return;
  if (clock.film) Object.assign(clock, { film: null, mode: "live" });
  clock.tracks = page.skins.map((one) => one.history);
}

function drawState(shown) {
  const silent = page.skins.filter((one) => one.silent), { film } = clock, many = page.skins.length > 1;
  const [state, text] = page.gone !== null ? ["gone", "Viewer unreachable"]
    : film && !film.ready(clock.at) ? ["waiting", "Loading"]
    : clock.mode !== "live" ? ["paused", clock.mode === "playing" ? "Playing" : "Paused"]
    : silent.length && silent.length === page.skins.length ? ["silent", "No frames"]
    : silent.length ? ["part", `${page.skins.length - silent.length} of ${page.skins.length} live`]
    : shown ? ["live", "Live"] : ["waiting", "Waiting"];
  $("state").dataset.state = state;
  if ($("state-text").textContent !== text) $("state-text").textContent = text;
  const said = page.gone !== null ? [page.gone || GONE]
    : film?.why ? [film.why]
    : page.skins.filter((one) => one.status?.text && (!one.silent || one === silent[0])).map((one) => {
      const names = (one.silent ? silent : [one]).map(({ name }) => name).join(", ");
      const waits = one.silent ? ". This page continues when frames arrive." : "";
      return `${many ? `${names}: ` : ""}${one.status.text}${waits}`;
    });
  panel.drawRecord(page.status);
  const notice = said.join(" ");
  $("notice").hidden = !notice;
  if ($("notice").textContent !== notice) $("notice").textContent = notice;
}

function drawSlow(shown) {
  const { one, history } = page;
  strips.drawTouches($("strip-touches"), history);
  strips.drawLatency($("strip-latency"), history);
  strips.drawLosses($("strip-losses"), history);
  strips.drawDrift($("strip-drift"), history);
  strips.drawMarks($("marks"), clock, history);
  if (!shown) return;
  const begun = one.head.begin_ms;
  panel.drawFacts(shown, one.rateAt(shown), begun ? new Date(begun + shown.t).toLocaleString() : "");
  panel.drawNow(shown, history.window(100));
  panel.drawSkipped(history, shown);
  panel.drawLog(history, shown);
}

function drawScene(shown, dark) {
  const items = page.skins.map((one) => {
    const frame = one.history.shown, [rows, columns] = frame?.head.shape ?? one.head.shape;
    return {
      surface: one.drawn, map: frame?.map ?? new Uint8Array(rows * columns), shape: [rows, columns],
      disc: one.head.outline === "disc", silent: one.silent,
    };
  });
  const box = boxOf(items.map((item) => item.surface)), matrix = scene.draw(camera, box, items, dark);
  if (!camera.settled) page.changed = true;
  page.project = drawOverlay($("overlay"), page.skins, page.selected, camera, matrix);
}

function drawWords(shown) {
  const { head, drawn } = page.one, many = page.skins.length > 1;
  const [rows, columns] = head.shape;
  $("flat-note").textContent =
    `${many ? `${head.name}, ` : ""}${head.size_mm[0]} × ${head.size_mm[1]} mm, ${columns} × ${rows} pixels`;
  $("surface-note").textContent = head.file ? head.file : many ? `${page.skins.length} skins in the robot's axes`
    : drawn.revision ? `cloud ${drawn.revision}`
    : shown?.head.cloud ? `drawn flat: cloud ${shown.head.cloud} was not received` : "flat: no cloud in use";
}

function draw(now) {
  if (clock.advance(now - page.at)) page.changed = true;
  page.at = now;
  clock.film?.fetch();
  if (page.changed && page.skins.length && page.skins.every(Boolean) && page.skins.length === page.skin.skins) {
    page.changed = false;
    const { history } = page, shown = history.shown;
    drawState(shown);
    if (fit($("scene"))) drawScene(shown, currentTheme() === "dark");
    flat.draw(page.skin, shown);
    panel.drawSkins(page.skins, page.selected, (of) => page.choose(of));
    panel.drawTouchTable(shown, page.skin.labels ?? page.one.state?.labels);
    panel.drawElectrodes(shown, page.skin.electrodes.length);
    drawWords(shown);
    if (clock.known) panel.drawTime(clock, history);
    if (now - page.slowAt >= SLOW_MS || clock.mode === "paused") {
      page.slowAt = now;
      drawSlow(shown);
    }
    page.drawings++;
  }
  requestAnimationFrame(draw);
}

listen(page, clock, camera, flat, strips, token);
new ResizeObserver(redraw).observe(document.body);
wearTheme();
requestAnimationFrame(draw);
follow(token, take, (why) => { page.gone = why; page.changed = true; if (!page.skin) drawState(null); });
window.eitskin = { page, clock, camera, flat, get history() { return page.history; } }; // for the console
