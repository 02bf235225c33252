// Points and cameras of the fleet: drag turns, with Shift or two fingers moves, wheel zooms.

import { colour, Surface, say } from "../frame/dom.js";
import { state, watch, selected } from "../link/store.js";
import { missing, listed } from "../frame/steps.js";
import { cameraOf, project, Raster } from "./raster.js";

const panel = document.getElementById("scene");
const note = panel.querySelector(".caption");
const start = { azimuth: Math.PI + 0.6, elevation: 0.45, distance: 0, target: [0, 0, 0] };
const view = { ...start };
const raster = new Raster();
const scratch = document.createElement("canvas").getContext("2d");
let surface,
  touched = false;

/** Draws and listens. */
export function startScene() {
  surface = new Surface(panel.querySelector("canvas"), draw);
  const { canvas } = surface,
    held = new Map();
  canvas.addEventListener("pointerdown", (e) => {
    canvas.setPointerCapture(e.pointerId);
    held.set(e.pointerId, surface.at(e));
  });
  canvas.addEventListener("pointermove", (e) => {
    if (held.has(e.pointerId)) drag(held, e);
  });
  for (const end of ["pointerup", "pointercancel"])
    canvas.addEventListener(end, (e) => held.delete(e.pointerId));
  canvas.addEventListener(
    "wheel",
    (e) => {
      e.preventDefault();
      zoom(Math.exp(e.deltaY / 500));
    },
    { passive: false },
  );
  canvas.addEventListener("dblclick", () => {
    touched = false;
    surface.draw();
  });
  watch(["clouds", "poses", "names", "selection", "matrix", "theme", "mode", "panel"], () => {
    const lost = missing();
    say(
      note,
      lost.length ? `${listed(lost, 4)} ${lost.length === 1 ? "is" : "are"} not in this space yet` : "",
    );
    surface.draw();
  });
}

function drag(held, e) {
  const at = surface.at(e),
    before = held.get(e.pointerId);
  const dx = at[0] - before[0],
    dy = at[1] - before[1];
  held.set(e.pointerId, at);
  if (!touched) settle();
  if (held.size > 1) pinch(held, e.pointerId, before, at);
  else if (e.shiftKey) shift(dx, dy);
  else {
    view.azimuth -= dx / 150;
    view.elevation = Math.min(Math.max(view.elevation + dy / 200, -0.2), 1.55);
  }
  surface.draw();
}

function pinch(held, id, before, at) {
  const [, other] = [...held].find(([key]) => key !== id);
  const reach = ([x, y]) => Math.hypot(x - other[0], y - other[1]) || 1;
  zoom(reach(before) / reach(at));
}

function shift(dx, dy) {
  const camera = cameraOf(view, surface.width, surface.height),
    s = view.distance / camera.focal;
  view.target = view.target.map((t, k) => t - s * dx * camera.right[k] + s * dy * camera.up[k]);
}

function zoom(factor) {
  if (!touched) settle();
  view.distance = Math.min(Math.max(view.distance * factor, 0.2), 5000);
  surface.draw();
}

/** From here on the operator decides where to look from. */
function settle() {
  touched = true;
}

/** All robots and most points in view. */
function look(robots) {
  const places = robots.map((r) => r.at);
  for (const { fleet } of state.clouds.values())
    for (let k = 0; k < fleet.length; k += 300) places.push([fleet[k], fleet[k + 1], fleet[k + 2]]);
  if (!places.length) return;
  const target = [0, 1, 2].map(
    (k) => (median(places.map((p) => p[k])) + (robots.length ? median(robots.map((r) => r.at[k])) : 0)) / 2,
  );
  const ahead = robots.reduce(
    (sum, r) => [sum[0] + Math.cos(r.heading), sum[1] + Math.sin(r.heading)],
    [0, 0],
  );
  const azimuth =
    Math.hypot(...ahead) > 0.3 * robots.length
      ? Math.atan2(ahead[1], ahead[0]) + Math.PI + 0.25
      : start.azimuth;
  Object.assign(view, { target, azimuth, elevation: start.elevation, distance: 1 });
  while (view.distance < 1e4 && seen(places) < 0.97 * places.length) view.distance *= 1.15;
  while (view.distance < 1e4 && seen(robots.map((r) => r.at)) < robots.length) view.distance *= 1.1;
}

/** How many places are on the screen, off its edge. */
function seen(places) {
  const camera = cameraOf(view, surface.width, surface.height);
  const inside = ([x, y]) => x > 24 && x < surface.width - 24 && y > 12 && y < surface.height - 34;
  return places.filter((place) => {
    const at = project(camera, place);
    return at && inside(at);
  }).length;
}

/** Pyramids that do not hide their neighbours. */
function sizeOf(robots) {
  const gap = (a) =>
    Math.min(...robots.map((b) => (b === a ? Infinity : Math.hypot(...a.at.map((x, k) => x - b.at[k])))));
  return Math.min(view.distance / 22, robots.length > 1 ? 0.8 * median(robots.map(gap)) : Infinity);
}

const median = (values) => values.sort((a, b) => a - b)[values.length >> 1];

/** Located robots with their place, their three axes and their name. */
function robotsNow() {
  return (state.poses ?? []).flatMap((p, k) => {
    if (!p.located || !state.names[k]) return [];
    const T = state.clouds.get(k)?.pose,
      c = Math.cos(p.heading),
      s = Math.sin(p.heading);
    const axes = T
      ? [0, 1, 2].map((a) => [T[a], T[a + 4], T[a + 8]])
      : [
          [c, s, 0],
          [-s, c, 0],
          [0, 0, 1],
        ];
    return [
      { k, name: state.names[k], heading: p.heading, at: T ? [T[3], T[7], T[11]] : [p.x, p.y, 0], axes },
    ];
  });
}

function draw(ctx, width, height) {
  const robots = robotsNow();
  if (!touched) look(robots);
  if (!view.distance) return;
  const camera = cameraOf(view, Math.round(width), Math.round(height));
  points(ctx, camera, width, height);
  floor(ctx, camera);
  links(ctx, camera, robots);
  const names = selected() ?? [],
    size = sizeOf(robots);
  for (const robot of robots)
    pyramid(ctx, camera, robot, size, colour(names.includes(robot.name) ? "red-text" : "good"));
  labels(ctx, camera, robots, names);
}

function points(ctx, camera, width, height) {
  const [w, h] = [Math.round(width), Math.round(height)];
  raster.resize(scratch, w, h);
  const base = parseInt(colour("scene").slice(1), 16);
  raster.clear(0xff000000 | ((base & 255) << 16) | (base & 0xff00) | (base >> 16));
  for (const { fleet, colours } of state.clouds.values())
    raster.cloud(state.theme === "dark", camera, fleet, colours);
  if (scratch.canvas.width !== w || scratch.canvas.height !== h)
    [scratch.canvas.width, scratch.canvas.height] = [w, h];
  scratch.putImageData(raster.picture, 0, 0);
  ctx.imageSmoothingEnabled = false;
  ctx.drawImage(scratch.canvas, 0, 0, width, height);
}

function line(ctx, camera, a, b) {
  const [p, q] = [project(camera, a), project(camera, b)];
  if (!p || !q) return;
  ctx.moveTo(p[0], p[1]);
  ctx.lineTo(q[0], q[1]);
}

function stroke(ctx, paint, wide, path) {
  ctx.strokeStyle = paint;
  ctx.lineWidth = wide;
  ctx.beginPath();
  path();
  ctx.stroke();
}

/** A grid around the origin and the origin's axes. */
function floor(ctx, camera) {
  const cell = 10 ** Math.ceil(Math.log10(view.distance / 8)) / 2,
    n = 5;
  stroke(ctx, colour("line"), 1, () => {
    for (let k = -n; k <= n; k++)
      for (let m = -n; m < n; m++) {
        line(ctx, camera, [k * cell, m * cell, 0], [k * cell, (m + 1) * cell, 0]);
        line(ctx, camera, [m * cell, k * cell, 0], [(m + 1) * cell, k * cell, 0]);
      }
  });
  [
    ["out-mark", [1, 0, 0]],
    ["good", [0, 1, 0]],
    ["focus", [0, 0, 1]],
  ].forEach(([paint, axis]) =>
    stroke(ctx, colour(paint), 2, () =>
      line(
        ctx,
        camera,
        [0, 0, 0],
        axis.map((x) => (x * view.distance) / 12),
      ),
    ),
  );
}

function links(ctx, camera, robots) {
  const { matrix, names } = state;
  if (!matrix || matrix.n !== names.length) return;
  const at = new Map(robots.map((robot) => [robot.k, robot.at]));
  for (const verdict of ["plausible", "verified"]) {
    ctx.setLineDash(verdict === "verified" ? [] : [4, 4]);
    stroke(ctx, colour(verdict === "verified" ? "link" : "link-weak"), 1, () => {
      for (const link of matrix.links)
        if (link.verdict === verdict && at.has(link.a) && at.has(link.b))
          line(ctx, camera, at.get(link.a), at.get(link.b));
    });
  }
  ctx.setLineDash([]);
}

/** A camera's pyramid; it opens forwards. */
function pyramid(ctx, camera, { at, axes: [x, y, z] }, size, paint) {
  const corner = (a, b) => at.map((t, k) => t + size * (x[k] + 0.6 * a * y[k] + 0.45 * b * z[k]));
  const corners = [corner(1, 1), corner(-1, 1), corner(-1, -1), corner(1, -1)];
  stroke(ctx, paint, 1.4, () =>
    corners.forEach((c, k) => {
      line(ctx, camera, at, c);
      line(ctx, camera, c, corners[(k + 1) % 4]);
    }),
  );
}

function labels(ctx, camera, robots, names) {
  ctx.font = "500 11px Inter, sans-serif";
  ctx.textAlign = "center";
  ctx.textBaseline = "middle";
  const few = robots.length <= 16;
  for (const { name, at } of robots) {
    if (!few && !names.includes(name) && name !== state.origin) continue;
    const place = project(camera, at);
    if (!place) continue;
    ctx.fillStyle = colour(names.includes(name) ? "red-text" : "text");
    ctx.fillText(name, place[0], place[1] + 13);
  }
}
