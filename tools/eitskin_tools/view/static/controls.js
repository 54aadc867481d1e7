// Buttons, keys, and the pointer on the flat map and the strips.

const $ = (id) => document.getElementById(id);
const THEMES = { system: "light", light: "dark", dark: "system" };
const system = matchMedia("(prefers-color-scheme: dark)");

function keep(theme) {
  try { localStorage.setItem("eitskin-theme", theme); } catch { /* this browser stores nothing */ }
}

function kept() {
  try { return localStorage.getItem("eitskin-theme") ?? "system"; } catch { return "system"; }
}

let theme = kept() in THEMES ? kept() : "system";

/** Light or dark, as chosen by the user or the system. */
export function currentTheme() {
  return theme === "system" ? (system.matches ? "dark" : "light") : theme;
}

export function wearTheme() {
  const { dataset } = document.documentElement;
  if (theme === "system") delete dataset.theme; else dataset.theme = theme;
  $("theme").textContent = `Theme: ${theme}`;
}

export function listen(page, clock, camera, flat, strips, token) {
  const redraw = () => { page.changed = true; page.slowAt = 0; };
  const acts = {
    pause: () => (clock.mode === "paused" ? clock.play() : clock.pause()),
    back: () => page.history && clock.step(page.history, -1),
    forward: () => page.history && clock.step(page.history, 1),
    live: () => clock.live(),
    theme: () => { theme = THEMES[theme]; keep(theme); wearTheme(); },
    record: () => record(page, token),
    help: () => $("keys").showModal(),
    next: () => page.history && clock.leap(page.history, 1),
    previous: () => page.history && clock.leap(page.history, -1),
    skin: () => page.choose(page.selected + 1),
  };
  const act = (name) => { acts[name](); redraw(); };
  for (const name of Object.keys(acts)) $(name)?.addEventListener("click", () => act(name));
  system.addEventListener("change", redraw);
  $("scrub").addEventListener("input", () => {
    if (clock.known) clock.go(clock.begin + Number($("scrub").value));
    redraw();
  });
  const views = { closer: () => camera.closer(1.2), farther: () => camera.closer(1 / 1.2) };
  const look = (name) => (views[name] ? views[name]() : camera.view(name));
  for (const button of document.querySelectorAll("[data-view]")) {
    button.addEventListener("click", () => look(button.dataset.view));
  }

  const keys = {
    " ": "pause", ",": "back", ".": "forward", p: "previous", n: "next", l: "live", s: "skin", r: "record", t: "theme",
    "?": "help",
  };
  const looks = { 1: "tilted", 2: "above", 3: "front", "+": "closer", "=": "closer", "-": "farther" };
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.altKey || event.metaKey || $("keys").open) return;
    if (event.key === " " && event.target.closest("button")) return; // it presses the button
    const key = event.key.toLowerCase();
    if (keys[key]) act(keys[key]); else if (looks[key]) look(looks[key]); else return;
    event.preventDefault();
  });

  const pointed = (event) => {
    const { left, top } = $("flat").getBoundingClientRect();
    const found = flat.under(event.clientX - left, event.clientY - top, page.skin, page.history?.shown);
    $("flat").title = found ? `x ${found.x.toFixed(0)} mm, y ${found.y.toFixed(0)} mm: ${found.value.toFixed(2)}` : "";
  };
  $("flat").addEventListener("pointermove", pointed);
  for (const canvas of document.querySelectorAll(".strips canvas")) {
    canvas.addEventListener("click", (event) => {
      if (page.history) clock.go(strips.timeAt(canvas, event, page.history));
      redraw();
    });
  }
  $("log").addEventListener("click", (event) => {
    const { t } = event.target.closest("li")?.dataset ?? {};
    if (t !== undefined) clock.go(Number(t));
    redraw();
  });
}

async function record(page, token) {
  if ($("record").hidden) return;
  $("record").disabled = true;
  try {
    const headers = token ? { Authorization: `Bearer ${token}` } : {};
    const answer = await fetch(page.status.recording ? "record/stop" : "record/start", { method: "POST", headers });
    $("record").title = (await answer.text()) || $("record").title;
  } finally {
    $("record").disabled = false;
  }
}
