// Canvases with one pixel for each pixel of the screen, and the colours of the style sheet.

/** Give a canvas its size on the screen; return {width, height} in CSS pixels, or null while it has none. */
export function fit(canvas) {
  const { width, height } = canvas.getBoundingClientRect(), ratio = Math.min(window.devicePixelRatio || 1, 2);
  if (width < 2 || height < 2) return null;
  const w = Math.round(width * ratio), h = Math.round(height * ratio);
  if (canvas.width !== w || canvas.height !== h) Object.assign(canvas, { width: w, height: h });
  return { width, height, ratio };
}

/** A cleared 2-D context in CSS pixels, or null. */
export function paper(canvas) {
  const size = fit(canvas);
  if (!size) return null;
  const pen = canvas.getContext("2d");
  pen.setTransform(size.ratio, 0, 0, size.ratio, 0, 0);
  pen.clearRect(0, 0, size.width, size.height);
  return { pen, ...size };
}

const NAMES = [
  "card", "line", "text", "muted", "accent", "good", "warn", "bad", "stage", "s1", "s2", "s3", "s4", "s5", "s6",
];

/** The style sheet's colours as they are now. */
export function inks() {
  const style = getComputedStyle(document.documentElement);
  return Object.fromEntries(NAMES.map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
}

export const FONT = '11px system-ui, -apple-system, "Segoe UI", Roboto, "DejaVu Sans", sans-serif';
export const BOLD = `600 ${FONT}`;

/** A number in a pill, which marks a touch in both pictures. */
export function pill(pen, text, x, y) {
  pen.font = BOLD;
  const width = Math.max(18, pen.measureText(text).width + 10);
  pen.beginPath();
  pen.roundRect(x - width / 2, y - 9, width, 18, 9);
  pen.fillStyle = "#0b0e13";
  pen.fill();
  pen.lineWidth = 1.5;
  pen.strokeStyle = "#ffffff";
  pen.stroke();
  pen.fillStyle = "#ffffff";
  pen.textAlign = "center";
  pen.textBaseline = "middle";
  pen.fillText(text, x, y + 0.5);
}

/** The faulty electrodes: {number: {state, repair}}. */
export function illOf(frame) {
  const ill = {};
  for (const [number, state, repair] of frame?.head.electrodes ?? []) ill[Number(number)] = { state, repair };
  return ill;
}

/** An electrode: a round mark, or a diamond if it is faulty. */
export function electrode(pen, ink, number, ill, x, y, textX, textY) {
  pen.beginPath();
  if (ill) {
    pen.moveTo(x, y - 6.5); pen.lineTo(x + 6.5, y); pen.lineTo(x, y + 6.5); pen.lineTo(x - 6.5, y); pen.closePath();
  } else {
    pen.arc(x, y, 3.5, 0, 7);
  }
  pen.fillStyle = ill ? ink.warn : ink.good;
  pen.fill();
  pen.lineWidth = 1.5;
  pen.strokeStyle = ink.card;
  pen.stroke();
  pen.font = ill ? BOLD : FONT;
  pen.fillStyle = ill ? ink.warn : ink.muted;
  pen.textAlign = "center";
  pen.textBaseline = "middle";
  pen.fillText(String(number), textX, textY);
}
