// A camera that turns around a box and shows all of it; z is up. Matrices are column by column, as in WebGL.

import { cross, unit } from "./surface.js";

const FIELD_RAD = 0.5;
const MARGIN = 1.3; // for numbers, normals, names and the buttons below
// Yaw and pitch. The front is seen from above the box's top, so that a level skin there does not shrink to a line.
const VIEWS = { tilted: [-0.42, 0.66], above: [0, 1.5607], front: [0, 0.4] };

export class Camera {
  constructor(canvas, onChange, onClick) {
    this.zoom = 1;
    this.box = null;
    this.view("tilted");
    this.onChange = onChange;
    this.onClick = onClick;
    this.listen(canvas);
  }

  view(name) {
    [this.yaw, this.pitch] = VIEWS[name];
    this.zoom = 1;
    this.onChange?.();
  }

  turn(dx, dy) {
    this.yaw -= dx;
    this.pitch = Math.min(Math.max(this.pitch + dy, -1.5607), 1.5607);
    this.onChange();
  }

  closer(factor) {
    this.zoom = Math.min(Math.max(this.zoom * factor, 0.4), 8);
    this.onChange();
  }

  /** Follow a box, slowly, so that a bending sheet does not jump. */
  look({ low, high }) {
    const follow = (from, to) => from.map((value, k) => value + 0.2 * (to[k] - value));
    const near = (from, to) => from.every((value, k) => Math.abs(value - to[k]) < 0.1);
    this.box = this.box ? { low: follow(this.box.low, low), high: follow(this.box.high, high) } : { low, high };
    this.settled = near(this.box.low, low) && near(this.box.high, high); // while paused, too, it is drawn until then
  }

  /** World to clip, for a picture of some width over height. */
  matrix(aspect) {
    const { yaw, pitch, box: { low, high } } = this;
    const back = [Math.sin(yaw) * Math.cos(pitch), -Math.cos(yaw) * Math.cos(pitch), Math.sin(pitch)];
    const right = [Math.cos(yaw), Math.sin(yaw), 0], up = cross(back, right);
    const centre = low.map((value, k) => (value + high[k]) / 2), half = high.map((value, k) => value - centre[k]);
    const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    const f = 1 / Math.tan(FIELD_RAD / 2);
    const distances = [0, 1, 2, 3, 4, 5, 6, 7].map((n) => { // at which each corner of the box is within the picture
      const corner = half.map((value, k) => (n & (1 << k) ? value : -value));
      const aside = Math.max(Math.abs(dot(right, corner)) / aspect, Math.abs(dot(up, corner)));
      return dot(back, corner) + MARGIN * f * aside;
    });
    const distance = Math.max(...distances, 1) / this.zoom, near = distance * 0.05;
    const far = distance + Math.hypot(...half) * 12, eye = centre.map((value, k) => value + back[k] * distance);
    const view = [right[0], up[0], back[0], 0, right[1], up[1], back[1], 0,
      right[2], up[2], back[2], 0, -dot(right, eye), -dot(up, eye), -dot(back, eye), 1];
    const lens = [f / aspect, 0, 0, 0, 0, f, 0, 0, 0, 0, (far + near) / (near - far),
      -1, 0, 0, (2 * far * near) / (near - far), 0];
    const out = new Float32Array(16);
    for (let c = 0; c < 4; c++) {
      for (let r = 0; r < 4; r++) for (let k = 0; k < 4; k++) out[4 * c + r] += lens[4 * k + r] * view[4 * c + k];
    }
    this.eye = eye;
    this.light = unit(back.map((value, k) => value + 0.55 * up[k] - 0.45 * right[k]));
    return out;
  }

  listen(canvas) {
    let from = null, begun = null;
    canvas.addEventListener("pointerdown", (event) => {
      from = begun = [event.clientX, event.clientY];
      canvas.setPointerCapture(event.pointerId);
    });
    canvas.addEventListener("pointermove", (event) => {
      if (!from) return;
      this.turn((event.clientX - from[0]) * 0.008, (event.clientY - from[1]) * 0.008);
      from = [event.clientX, event.clientY];
    });
    for (const name of ["pointerup", "pointercancel"]) {
      canvas.addEventListener(name, (event) => {
        const { left, top } = canvas.getBoundingClientRect(), { clientX, clientY } = event;
        const still = begun && Math.hypot(clientX - begun[0], clientY - begun[1]) < 4;
        if (still && name === "pointerup") this.onClick?.(clientX - left, clientY - top);
        from = begun = null;
      });
    }
    canvas.addEventListener("dblclick", () => this.view("tilted"));
    canvas.addEventListener("wheel", (event) => {
      if (!event.ctrlKey && document.activeElement !== canvas) return; // the page scrolls until the surface was clicked
      event.preventDefault();
      this.closer(Math.exp(-event.deltaY * 0.0015));
    }, { passive: false });
    canvas.addEventListener("keydown", (event) => {
      const turns = { ArrowLeft: [-0.08, 0], ArrowRight: [0.08, 0], ArrowUp: [0, 0.08], ArrowDown: [0, -0.08] };
      if (turns[event.key] && !event.ctrlKey && !event.altKey && !event.metaKey) {
        this.turn(...turns[event.key]);
        event.preventDefault();
      }
    });
  }
}
