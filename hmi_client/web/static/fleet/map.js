// The fleet from above: positions, headings, two-sigma ellipses, links; robots without a place apart.

import { el, colour, Surface } from "../frame/dom.js";
import { state, watch, selected } from "../link/store.js";
import { command, run } from "../link/commands.js";

const panel = document.getElementById("map");
const apart = panel.querySelector(".apart");
const REACH = { mouse: 12, pen: 12, touch: 24 };
const view = { zoom: 1, dx: 0, dy: 0, ellipses: true, follow: false };
let surface,
  shown = [];

/** Draws and listens; gives `pan(dx, dy)` for the arrows. */
export function startMap() {
  surface = new Surface(panel.querySelector("canvas"), draw);
  const { canvas } = surface;
  let held = null;
  canvas.addEventListener("pointerdown", (e) => {
    held = { at: surface.at(e), moved: false };
    canvas.setPointerCapture(e.pointerId);
  });
  canvas.addEventListener("pointermove", (e) => {
    if (held) held = drag(held, surface.at(e));
  });
  canvas.addEventListener("pointerup", (e) => {
    if (held && !held.moved) choose(surface.at(e), REACH[e.pointerType] ?? 12);
    held = null;
  });
  canvas.addEventListener(
    "wheel",
    (e) => {
      e.preventDefault();
      zoomBy(Math.exp(-e.deltaY / 400));
    },
    { passive: false },
  );
  command("ellipses", () => {
    view.ellipses = !view.ellipses;
    surface.draw();
  });
  command("follow", () => {
    view.follow = !view.follow;
    surface.draw();
  });
  watch(["poses", "names", "selection", "matrix", "clouds", "theme", "questions"], () => {
    drawApart();
    surface.draw();
  });
  return {
    pan: (dx, dy) => {
      view.dx -= 12 * dx;
      view.dy -= 12 * dy;
      surface.draw();
      return true;
    },
  };
}

function drag(held, at) {
  const dx = at[0] - held.at[0],
    dy = at[1] - held.at[1];
  if (!held.moved && Math.hypot(dx, dy) < 4) return held;
  view.dx += dx;
  view.dy += dy;
  surface.draw();
  return { at, moved: true };
}

function zoomBy(factor) {
  const zoom = Math.min(Math.max(view.zoom * factor, 0.5), 60);
  view.dx *= zoom / view.zoom;
  view.dy *= zoom / view.zoom;
  view.zoom = zoom;
  surface.draw();
}

/** A robot of the map becomes the second of the pair, or the one that `why` is asked of. */
function choose([x, y], reach) {
  const best = shown.map((r) => [Math.hypot(r.x - x, r.y - y), r.name]).sort((a, b) => a[0] - b[0])[0];
  if (best && best[0] <= reach) run("why", { robot: best[1] });
}

function drawApart() {
  const lost = state.poses ? state.names.filter((_, k) => !state.poses[k]?.located) : [];
  apart.hidden = !lost.length;
  if (!lost.length) return;
  const names = selected() ?? [];
  const anchor = state.origin ?? "the fleet";
  apart.replaceChildren(
    el("span", "", `Not joined to ${anchor}: place not known`),
    el("div", "", ...lost.map((name) => el("b", names.includes(name) ? "robot" : "", `${name}?`))),
  );
}

/** Metres to CSS pixels: all robots and the origin fit, the origin in the middle while that is fair. */
function frameOf(poses, width, height) {
  const s = view.zoom / reachOf(poses, width, height);
  const focus = view.follow ? middleOf() : [0, 0];
  return {
    s,
    at: (x, y) => [width / 2 + view.dx + (x - focus[0]) * s, height / 2 + view.dy - (y - focus[1]) * s],
  };
}

/** Metres per pixel that keep every robot inside. */
function reachOf(poses, width, height) {
  const of = (value, room) => (2 * Math.abs(value)) / Math.max(40, room);
  return Math.max(0.002, ...poses.map((p) => Math.max(of(p.x, width - 70), of(p.y, height - 80))));
}

function middleOf() {
  const names = selected() ?? [];
  const places = names.map((name) => state.poses[state.names.indexOf(name)]).filter((p) => p?.located);
  return places.length
    ? [0, 1].map((k) => places.reduce((sum, p) => sum + (k ? p.y : p.x), 0) / places.length)
    : [0, 0];
}

function draw(ctx, width, height) {
  shown = [];
  const located = (state.poses ?? [])
    .map((p, k) => ({ ...p, name: state.names[k], k }))
    .filter((p) => p.located && p.name);
  ctx.font = "500 12px Inter, sans-serif";
  if (!located.length) return words(ctx, "No robot has a place yet", 12, 22, colour("dim"));
  const { s, at } = frameOf(located, width, height),
    names = selected() ?? [];
  axes(ctx, at, s, width, height);
  ground(ctx, at);
  links(ctx, at, located);
  for (const p of located) robot(ctx, p, at, s, names.includes(p.name));
  labels(ctx, located, at, names);
  words(ctx, `${state.origin ?? "the anchor"} is at (0, 0)`, 12, 20, colour("dim"));
  scaleBar(ctx, s, height);
}

function words(ctx, text, x, y, paint, align = "left") {
  ctx.textAlign = align;
  ctx.textBaseline = "middle";
  ctx.fillStyle = paint;
  ctx.fillText(text, x, y);
}

function axes(ctx, at, s, width, height) {
  const [x0, y0] = at(0, 0);
  ctx.strokeStyle = colour("line");
  ctx.lineWidth = 1;
  ctx.beginPath();
  ctx.moveTo(0, y0);
  ctx.lineTo(width, y0);
  ctx.moveTo(x0, 0);
  ctx.lineTo(x0, height);
  ctx.stroke();
}

/** Every 4th point of the clouds, dimly. */
function ground(ctx, at) {
  ctx.fillStyle = colour("cloud");
  for (const { fleet } of state.clouds.values()) {
    for (let k = 0; k < fleet.length; k += 12) {
      const [x, y] = at(fleet[k], fleet[k + 1]);
      ctx.fillRect(x, y, 1, 1);
    }
  }
}

/** Proven pairs by a line, unproven by dashes. */
function links(ctx, at, located) {
  if (!state.matrix || state.matrix.n !== state.names.length) return;
  ctx.lineWidth = 1;
  const place = new Map(located.map((p) => [p.k, at(p.x, p.y)]));
  for (const proven of [false, true]) {
    ctx.setLineDash(proven ? [] : [4, 4]);
    ctx.strokeStyle = colour(proven ? "link" : "link-weak");
    ctx.beginPath();
    for (const { a, b, verdict } of state.matrix.links) {
      if ((verdict === "verified") !== proven || !place.has(a) || !place.has(b)) continue;
      ctx.moveTo(...place.get(a));
      ctx.lineTo(...place.get(b));
    }
    ctx.stroke();
  }
  ctx.setLineDash([]);
}

function robot(ctx, p, at, s, chosen) {
  const [x, y] = at(p.x, p.y),
    paint = colour(chosen ? "red-text" : "good");
  const size = state.names.length > 24 && !chosen ? 2.5 : 4.5;
  shown.push({ x, y, name: p.name });
  if (view.ellipses && Number.isFinite(p.xx)) ellipse(ctx, [x, y], p, s);
  ctx.fillStyle = ctx.strokeStyle = paint;
  ctx.globalAlpha = 0.35;
  ctx.beginPath();
  ctx.moveTo(x, y);
  for (const side of [-0.35, 0.35])
    ctx.lineTo(x + 4 * size * Math.cos(p.heading + side), y - 4 * size * Math.sin(p.heading + side));
  ctx.fill();
  ctx.globalAlpha = 1;
  ctx.beginPath();
  ctx.arc(x, y, size, 0, 2 * Math.PI);
  ctx.fill();
  if (p.name !== state.origin) return;
  ctx.beginPath();
  ctx.arc(x, y, 8.5, 0, 2 * Math.PI);
  ctx.stroke();
}

/** Two sigma of the position. */
function ellipse(ctx, [x, y], { xx, xy, yy }, s) {
  const mean = (xx + yy) / 2,
    d = Math.hypot((xx - yy) / 2, xy);
  const [a, b] = [mean + d, Math.max(mean - d, 0)].map((v) => Math.max(1, 2 * Math.sqrt(Math.max(v, 0)) * s));
  ctx.strokeStyle = colour("dim");
  ctx.lineWidth = 1;
  ctx.beginPath();
  ctx.ellipse(x, y, a, b, -Math.atan2(2 * xy, xx - yy) / 2, 0, 2 * Math.PI);
  ctx.stroke();
}

/** Names where they fit; the selected first. */
function labels(ctx, located, at, names) {
  const taken = [];
  const first = (p) => (names.includes(p.name) ? 0 : p.name === state.origin ? 1 : 2);
  for (const p of [...located].sort((a, b) => first(a) - first(b))) {
    const chosen = names.includes(p.name);
    const [x, y] = at(p.x, p.y),
      w = ctx.measureText(p.name).width,
      left = x - w - 14;
    const box = [left - 4, y - 9, w + 8, 18];
    if (!chosen && taken.some((t) => overlap(t, box))) continue;
    taken.push(box);
    if (chosen) {
      ctx.fillStyle = colour("red");
      ctx.beginPath();
      ctx.roundRect(...box, 4);
      ctx.fill();
    }
    words(ctx, p.name, left, y, chosen ? colour("on-red") : colour("text"));
  }
}

const overlap = ([x, y, w, h], [a, b, c, d]) => x < a + c && a < x + w && y < b + d && b < y + h;

function scaleBar(ctx, s, height) {
  const metres = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500].find((m) => m * s >= 55) ?? 1000;
  const y = height - 16;
  ctx.strokeStyle = colour("dim");
  ctx.lineWidth = 1;
  ctx.beginPath();
  ctx.moveTo(12, y - 4);
  ctx.lineTo(12, y);
  ctx.lineTo(12 + metres * s, y);
  ctx.lineTo(12 + metres * s, y - 4);
  ctx.stroke();
  words(ctx, `${metres} m`, 20 + metres * s, y - 2, colour("dim"));
}
