// The map laid flat: pixels as they are, axes in mm with y upwards, electrodes by number, touches as ellipses.

import { FONT, electrode, illOf, inks, paper, pill } from "./canvas.js";

const MARGIN = { left: 66, right: 26, top: 26, bottom: 58 };

export class FlatMap {
  constructor(canvas) {
    this.canvas = canvas;
    this.picture = document.createElement("canvas");
  }

  setColours(palette) { this.palette = palette; }

  /** CSS pixels of a place on the sheet. */
  place(x, y) {
    const { x0, y0, scale } = this.box;
    return [x0 + x * scale, y0 - y * scale];
  }

  draw(skin, frame) {
    const sheet = paper(this.canvas);
    if (!sheet || !this.palette) return;
    const { pen, width, height } = sheet, ink = inks(), [length, wide] = skin.size_mm;
    const room = [width - MARGIN.left - MARGIN.right, height - MARGIN.top - MARGIN.bottom];
    const scale = Math.max(Math.min(room[0] / length, room[1] / wide), 0.05);
    const x0 = MARGIN.left + (room[0] - length * scale) / 2;
    const y0 = MARGIN.top + (room[1] - wide * scale) / 2 + wide * scale;
    this.box = { x0, y0, scale };
    pen.save();
    if (skin.outline === "disc") {
      pen.beginPath();
      pen.arc(x0 + (length * scale) / 2, y0 - (wide * scale) / 2, (length * scale) / 2, 0, 7);
      pen.clip();
    }
    this.paint(pen, frame, skin);
    pen.restore();
    this.axes(pen, ink, skin);
    const ill = illOf(frame), middle = [length / 2, wide / 2];
    skin.electrodes.forEach(([x, y], number) => {
      const [px, py] = this.place(x, y);
      const out = skin.outline === "disc" ? [x - middle[0], y - middle[1]] : sideOf(x, y, length, wide);
      const far = Math.hypot(...out) || 1;
      electrode(pen, ink, number, ill[number], px, py, px + (out[0] / far) * 14, py - (out[1] / far) * 14);
    });
    for (const touch of frame?.head.touches ?? []) this.touch(pen, touch);
  }

  paint(pen, frame, skin) {
    const [rows, columns] = frame?.head.shape ?? skin.shape, { picture, palette } = this;
    if (picture.width !== columns || picture.height !== rows) Object.assign(picture, { width: columns, height: rows });
    const on = picture.getContext("2d"), image = on.createImageData(columns, rows);
    for (let r = 0; r < rows; r++) {
      for (let c = 0; c < columns; c++) {
        const level = 4 * (frame?.map[(rows - 1 - r) * columns + c] ?? 0), i = 4 * (r * columns + c);
        for (let k = 0; k < 4; k++) image.data[i + k] = palette[level + k];
      }
    }
    on.putImageData(image, 0, 0);
    const { x0, y0, scale } = this.box, [length, wide] = skin.size_mm;
    pen.imageSmoothingEnabled = false;
    pen.drawImage(picture, x0, y0 - wide * scale, length * scale, wide * scale);
  }

  axes(pen, ink, skin) {
    const [length, wide] = skin.size_mm, { x0, y0, scale } = this.box, step = Math.max(length, wide) > 200 ? 50 : 25;
    pen.strokeStyle = ink.line;
    pen.lineWidth = 1;
    if (skin.outline !== "disc") pen.strokeRect(x0, y0 - wide * scale, length * scale, wide * scale);
    pen.font = FONT;
    pen.fillStyle = ink.muted;
    pen.strokeStyle = ink.muted;
    const every = scale * step < 26 ? 2 * step : step;
    pen.textBaseline = "top";
    pen.textAlign = "center";
    pen.beginPath();
    for (let x = 0; x <= length; x += every) {
      const px = Math.round(x0 + x * scale) + 0.5;
      pen.moveTo(px, y0 + 23); pen.lineTo(px, y0 + 27);
      pen.fillText(String(x), px, y0 + 30);
    }
    pen.textBaseline = "middle";
    pen.textAlign = "right";
    for (let y = 0; y <= wide; y += every) {
      const py = Math.round(y0 - y * scale) + 0.5;
      pen.moveTo(x0 - 30, py); pen.lineTo(x0 - 26, py);
      pen.fillText(String(y), x0 - 33, py);
    }
    pen.stroke();
    pen.textAlign = "center";
    pen.textBaseline = "alphabetic";
    pen.fillText("x, mm", x0 + (length * scale) / 2, y0 + 56);
    pen.save();
    pen.translate(x0 - 64, y0 - (wide * scale) / 2);
    pen.rotate(-Math.PI / 2);
    pen.textBaseline = "top";
    pen.fillText("y, mm", 0, 0);
    pen.restore();
  }

  touch(pen, touch) {
    const [x, y] = this.place(...touch.centre), { scale } = this.box;
    for (const [colour, wide] of [["#0b0e13", 4], ["#ffffff", 2]]) {
      pen.strokeStyle = colour;
      pen.lineWidth = wide;
      pen.beginPath();
      pen.ellipse(x, y, (touch.axes[0] / 2) * scale, (touch.axes[1] / 2) * scale, -touch.angle, 0, 7);
      pen.stroke();
    }
    pill(pen, String(touch.id), x, y - (touch.axes[0] / 2) * scale - 13);
  }

  /** Place on the sheet and value under CSS pixels, or null beside it. */
  under(px, py, skin, frame) {
    if (!this.box || !frame) return null;
    const { x0, y0, scale } = this.box, x = (px - x0) / scale, y = (y0 - py) / scale,
      [rows, columns] = frame.head.shape;
    const c = Math.floor((x / skin.size_mm[0]) * columns), r = Math.floor((y / skin.size_mm[1]) * rows);
    return r < 0 || c < 0 || r >= rows || c >= columns ? null : { x, y, value: frame.map[r * columns + c] / 255 };
  }
}

function sideOf(x, y, length, wide) {
  const gaps = [[y, [0, -1]], [length - x, [1, 0]], [wide - y, [0, 1]], [x, [-1, 0]]];
  return gaps.sort((a, b) => a[0] - b[0])[0][1];
}
