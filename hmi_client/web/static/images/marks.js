// Marks in image pixels, drawn alike in image and loupe. `at(pixel)` gives CSS pixels of the canvas.

import { state, markerColour } from "../link/store.js";
import { colour } from "../frame/dom.js";

const GAP = 9,
  BEYOND = 40; // CSS pixels that a mark reaches from its place

/** What a side's image shows: points of this view, half a pick, the guess, the misfit. */
export function marksOf(side) {
  const { list, assist } = state;
  const points = list.points
    .filter((p) => !p.other_view && (side ? p.pj : p.pi))
    .map((p) => ({
      id: p.id,
      n: p.n,
      pixel: side ? p.pj : p.pi,
      paint: isBad(p) ? colour("out-mark") : markerColour(p.n),
      text: isBad(p) ? `${p.n}!` : `${p.n}`,
    }));
  const missing = list.points.every((p) => p.status !== "half");
  if (list.half?.side === side && missing) points.push({ id: null, ...nextMark(), pixel: list.half.pixel });
  const expected = assist.expected && assist.side === side ? assist.expected : null;
  return {
    points,
    expected,
    wrong: misfitOf(side),
    hints: assist.hints.filter((h) => h.side === side),
  };
}

/** The point that does not fit, where this side shows the very view that it was clicked in. */
export function misfitOf(side) {
  const { wrong } = state.assist;
  const point = wrong && state.list.points.find((p) => p.id === wrong.id);
  return wrong?.side === side && wrong.fits && point && !point.other_view ? wrong : null;
}

export const isBad = (point) => point.status === "outlier" || point.status === "rejected";

function nextMark() {
  const n = 1 + Math.max(0, ...state.list.points.map((p) => p.n));
  return { n, paint: markerColour(n), text: `${n}` };
}

/** The nearest mark within `reach` CSS pixels, or null. */
export function nearest(marks, at, [x, y], reach) {
  const far = marks.points.map((m) => {
    const [mx, my] = at(m.pixel);
    return [Math.hypot(mx - x, my - y), m];
  });
  const [best] = far.sort((a, b) => a[0] - b[0]);
  return best && best[0] <= reach ? best[1] : null;
}

/** All marks of a side. */
export function drawMarks(ctx, marks, at, width, captions = true) {
  if (state.marksHidden) return;
  if (marks.expected) drawExpected(ctx, marks.expected, at, width, captions);
  if (marks.wrong) drawWrong(ctx, marks.wrong, at, width, captions);
  for (const mark of marks.points) drawPoint(ctx, at(mark.pixel), mark, width);
  for (const hint of captions ? marks.hints : [])
    if (hint.label.startsWith(state.typed))
      chip(ctx, at(hint.pixel), hint.label.toUpperCase(), "#fff", width, [0, 0]);
}

function stroked(ctx, paint, wide, path, dash = []) {
  for (const [style, w] of [
    ["#000c", wide + 2],
    [paint, wide],
  ]) {
    ctx.setLineDash(style === paint ? dash : []); // dashes lie on a dark line, to be seen on any picture
    ctx.strokeStyle = style;
    ctx.lineWidth = w;
    ctx.beginPath();
    path();
    ctx.stroke();
  }
  ctx.setLineDash([]);
}

function drawPoint(ctx, [x, y], { paint, text }, width) {
  const height = (width * ctx.canvas.height) / ctx.canvas.width;
  if (Math.min(x, y, width - x, height - y) < -BEYOND) return; // most of many points lie outside a loupe
  stroked(ctx, paint, 2, () => ctx.arc(x, y, 8, 0, 2 * Math.PI));
  chip(ctx, [x, y], text, paint, width, [16, -17]);
}

/** A number on its colour, beside a place and inside the canvas. */
function chip(ctx, [x, y], text, paint, width, [dx, dy]) {
  ctx.font = "700 12px Inter, sans-serif";
  const w = Math.max(19, ctx.measureText(text).width + 9);
  const cx = x + dx + w > width ? x - Math.abs(dx) : x + dx;
  const cy = y + dy < 12 ? y - dy : y + dy;
  ctx.beginPath();
  ctx.roundRect(cx - w / 2, cy - 9.5, w, 19, 4);
  ctx.fillStyle = paint;
  ctx.strokeStyle = "#000";
  ctx.lineWidth = 1.5;
  ctx.fill();
  ctx.stroke();
  ctx.fillStyle = "#000";
  ctx.textAlign = "center";
  ctx.textBaseline = "middle";
  ctx.fillText(text, cx, cy + 0.5);
}

function diamond(ctx, [x, y], paint) {
  stroked(ctx, paint, 2, () => {
    ctx.moveTo(x, y - 10);
    ctx.lineTo(x + 10, y);
    ctx.lineTo(x, y + 10);
    ctx.lineTo(x - 10, y);
    ctx.closePath();
  });
}

function caption(ctx, [x, y], text, paint, width) {
  ctx.font = "600 12px Inter, sans-serif";
  const w = ctx.measureText(text).width / 2;
  ctx.textAlign = "center";
  ctx.textBaseline = "alphabetic";
  ctx.lineJoin = "round";
  const cx = Math.min(Math.max(x, w + 6), width - w - 6),
    cy = y < 34 ? y + 26 : y - 16;
  ctx.strokeStyle = "#000";
  ctx.lineWidth = 3;
  ctx.strokeText(text, cx, cy);
  ctx.fillStyle = paint;
  ctx.fillText(text, cx, cy);
}

/** A guess: hollow, on a dotted line, and called one. It never looks like a click. */
function drawExpected(ctx, { pixel, line }, at, width, captions) {
  const paint = colour("guess-mark");
  const ends = (line ?? []).map(at);
  if (ends.length > 1)
    stroked(
      ctx,
      paint,
      1.6,
      () => ends.forEach(([x, y], k) => (k ? ctx.lineTo(x, y) : ctx.moveTo(x, y))),
      [3, 3],
    );
  if (!pixel) return;
  const place = at(pixel);
  diamond(ctx, place, paint);
  if (captions) caption(ctx, [place[0] - 46, place[1]], "expected here", paint, width);
}

function drawWrong(ctx, { clicked, fits }, at, width, captions) {
  const paint = colour("out-mark"),
    a = at(clicked),
    b = at(fits);
  stroked(
    ctx,
    paint,
    1.6,
    () => {
      ctx.moveTo(...a);
      ctx.lineTo(...b);
    },
    [5, 4],
  );
  diamond(ctx, b, paint);
  const beside = Math.abs(a[0] - b[0]) < 130 && Math.abs(a[1] - b[1]) < 40; // its number would lie on it
  if (captions) caption(ctx, [b[0], b[1] + (beside ? 42 : 0)], "the others put it here", paint, width);
}

/** Full hairlines with a gap: what lies under the cross stays free. */
export function hairlines(ctx, [x, y], width, height) {
  for (const [paint, wide] of [
    ["#000a", 2.5],
    ["#fff", 1],
  ]) {
    ctx.strokeStyle = paint;
    ctx.lineWidth = wide;
    ctx.beginPath();
    for (const [a, b, c, d] of [
      [0, y, x - GAP, y],
      [x + GAP, y, width, y],
      [x, 0, x, y - GAP],
      [x, y + GAP, x, height],
    ]) {
      ctx.moveTo(a, b);
      ctx.lineTo(c, d);
    }
    ctx.stroke();
  }
}

/** The cross of the loupe: four arms and one pixel's square. */
export function loupeCross(ctx, [x, y], pixelSize) {
  const h = pixelSize / 2;
  for (const [paint, wide] of [
    ["#000c", 3.5],
    ["#fff", 1.4],
  ]) {
    ctx.strokeStyle = paint;
    ctx.lineWidth = wide;
    ctx.beginPath();
    for (const [dx, dy] of [
      [1, 0],
      [-1, 0],
      [0, 1],
      [0, -1],
    ]) {
      ctx.moveTo(x + dx * (h + 2), y + dy * (h + 2));
      ctx.lineTo(x + dx * 30, y + dy * 30);
    }
    ctx.rect(x - h, y - h, 2 * h, 2 * h);
    ctx.stroke();
  }
}

export const tagOf = (side) => {
  const { list, assist } = state;
  if (misfitOf(0) || misfitOf(1))
    return [`point ${numberOf(assist.wrong.id)}, as you clicked it`, assist.wrong.side === side];
  if (assist.suggestion) return ["suggested", true];
  if (!list.half) return ["", false];
  return list.half.side === side ? ["picked", false] : ["click the same point here", true];
};

export const numberOf = (id) => state.list.points.find((p) => p.id === id)?.n ?? "";

/** How deep the place under the cross is, where a click told it. */
export function depthAt(side, [u, v]) {
  const near = (p) => p && Math.hypot(p[0] - u, p[1] - v) < 1.5;
  const { points } = state.list,
    told = state.assist.suggestion;
  const found = [...points, ...(told ? [told] : [])].find((p) => near(side ? p.pj : p.pi));
  return found ? ((side ? found.depth_j : found.depth_i) ?? null) : null;
}
