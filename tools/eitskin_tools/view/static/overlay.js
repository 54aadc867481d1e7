// The overlay of the surface: touches with normals and numbers, electrodes, and the directions of x, y and z.

import { BOLD, FONT, electrode, illOf, inks, paper, pill } from "./canvas.js";

const ARROW_MM = 20;

/** Clip coordinates to CSS pixels of a canvas. */
export function projector(matrix, width, height) {
  return ([x, y, z]) => {
    const out = [0, 1, 3].map((r) => matrix[r] * x + matrix[4 + r] * y + matrix[8 + r] * z + matrix[12 + r]);
    return [((out[0] / out[2] + 1) / 2) * width, ((1 - out[1] / out[2]) / 2) * height];
  };
}

/** Draw the electrodes of the selected skin, the touches of all, and names if there are several skins. */
export function drawOverlay(canvas, skins, selected, camera, matrix) {
  const sheet = paper(canvas);
  if (!sheet) return null;
  const { pen, width, height } = sheet, ink = inks(), project = projector(matrix, width, height);
  const seen = (place, normal) => normal.reduce((sum, value, k) => sum + value * (camera.eye[k] - place[k]), 0) > 0;
  drawElectrodes(pen, ink, skins[selected], project);
  for (const one of skins) {
    const frame = one.history.shown;
    if (one.silent) continue;
    for (const touch of frame?.head.touches ?? []) drawTouch(pen, touch, frame, one.drawn, project, seen);
  }
  if (skins.length > 1) skins.forEach((one, of) => drawName(pen, ink, one, of === selected, project, width));
  drawAxes(pen, ink, matrix, height);
  return project;
}

/** The skin under a CSS pixel of the scene, or null. */
export function skinUnder(skins, project, x, y) {
  let [found, nearest] = [null, 28];
  skins.forEach((one, of) => {
    for (const place of spread(one.drawn, 9, 6)) {
      const [px, py] = project(place), away = Math.hypot(px - x, py - y);
      if (away < nearest) [found, nearest] = [of, away];
    }
  });
  return found;
}

/** Places spread over a surface. */
function spread(surface, across, along) {
  const [length, wide] = surface.sizeMm, found = [];
  for (let i = 0; i < across; i++) {
    for (let j = 0; j < along; j++) found.push(surface.at((i * length) / (across - 1), (j * wide) / (along - 1)).place);
  }
  return found;
}

/** A skin's name, above it. */
function drawName(pen, ink, one, isSelected, project, width) {
  const highest = spread(one.drawn, 5, 5).map(project).sort((a, b) => a[1] - b[1]).slice(0, 5);
  const text = one.silent ? `${one.name}: no frames` : one.name;
  pen.font = BOLD;
  const half = pen.measureText(text).width / 2 + 9;
  const middle = highest.reduce((sum, [px]) => sum + px, 0) / highest.length;
  const x = Math.min(Math.max(middle, half + 3), width - half - 3), y = Math.max(highest[0][1] - 24, 14);
  pen.beginPath();
  pen.roundRect(x - half, y - 11, 2 * half, 22, 7);
  pen.fillStyle = ink.card;
  pen.fill();
  pen.lineWidth = isSelected ? 2 : 1;
  pen.strokeStyle = one.silent ? ink.warn : isSelected ? ink.accent : ink.line;
  pen.stroke();
  pen.fillStyle = one.silent ? ink.warn : ink.text;
  pen.textAlign = "center";
  pen.textBaseline = "middle";
  pen.fillText(text, x, y + 0.5);
}

function drawElectrodes(pen, ink, { head: skin, history, drawn: surface }, project) {
  const ill = illOf(history.shown), middle = [skin.size_mm[0] / 2, skin.size_mm[1] / 2];
  skin.electrodes.forEach(([x, y], number) => {
    const { place } = surface.at(x, y), [px, py] = project(place);
    const outX = x + (x - middle[0]) * 0.07, outY = y + (y - middle[1]) * 0.1;
    const step = surface.at(x - (outX - x), y - (outY - y)).place;
    const [tx, ty] = project(place.map((value, k) => 2 * value - step[k]));
    electrode(pen, ink, number, ill[number], px, py, tx, ty);
  });
}

function drawTouch(pen, touch, frame, surface, project, seen) {
  const given = frame.head.cloud === surface.revision && touch.normal.some((value) => value);
  const { place, normal } = given ? touch : surface.at(...touch.centre);
  const tip = place.map((value, k) => value + ARROW_MM * normal[k]);
  const [x, y] = project(place), [tx, ty] = project(tip), ahead = seen(place, normal);
  const ring = [];
  for (let k = 0; k <= 32; k++) {
    const a = (k * Math.PI) / 16, u = (touch.axes[0] / 2) * Math.cos(a), v = (touch.axes[1] / 2) * Math.sin(a);
    const c = Math.cos(touch.angle), s = Math.sin(touch.angle);
    ring.push(project(surface.at(touch.centre[0] + u * c - v * s, touch.centre[1] + u * s + v * c).place));
  }
  pen.setLineDash(ahead ? [] : [4, 3]);
  for (const [colour, wide] of [["#0b0e13", 4], ["#ffffff", 2]]) {
    pen.strokeStyle = pen.fillStyle = colour;
    pen.lineWidth = wide;
    pen.beginPath();
    ring.forEach(([rx, ry], k) => (k ? pen.lineTo(rx, ry) : pen.moveTo(rx, ry)));
    pen.moveTo(x, y);
    pen.lineTo(tx, ty);
    pen.stroke();
    const long = Math.hypot(tx - x, ty - y);
    if (long > 8) {
      const [ux, uy] = [(tx - x) / long, (ty - y) / long];
      pen.beginPath();
      pen.moveTo(tx + 3 * ux, ty + 3 * uy);
      pen.lineTo(tx - 7 * ux - 4 * uy, ty - 7 * uy + 4 * ux);
      pen.lineTo(tx - 7 * ux + 4 * uy, ty - 7 * uy - 4 * ux);
      pen.closePath();
      if (wide === 4) pen.stroke();
      pen.fill();
    }
  }
  pen.setLineDash([]);
  const long = Math.hypot(tx - x, ty - y) || 1;
  pill(pen, String(touch.id), tx + ((tx - x) / long) * 16, ty + ((ty - y) / long) * 16 - (long < 8 ? 16 : 0));
}

function drawAxes(pen, ink, matrix, height) {
  const at = [34, height - 34];
  pen.font = FONT;
  pen.textAlign = "center";
  pen.textBaseline = "middle";
  ["x", "y", "z"].forEach((name, axis) => {
    const dx = matrix[4 * axis], dy = matrix[4 * axis + 1], scale = 22 / Math.hypot(matrix[1], matrix[5], matrix[9]);
    const wide = Math.hypot(matrix[0], matrix[4], matrix[8]), tall = Math.hypot(matrix[1], matrix[5], matrix[9]);
    const end = [at[0] + ((dx * tall) / wide) * scale, at[1] - dy * scale];
    pen.strokeStyle = ink.muted;
    pen.lineWidth = 1.5;
    pen.beginPath();
    pen.moveTo(...at);
    pen.lineTo(...end);
    pen.stroke();
    const [lx, ly] = [end[0] - at[0], end[1] - at[1]], long = Math.hypot(lx, ly) || 1;
    if (long < 5) return;
    pen.fillStyle = ink.text;
    pen.fillText(name, end[0] + (lx / long) * 8, end[1] + (ly / long) * 8);
  });
}
