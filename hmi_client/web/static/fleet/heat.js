// The matrix of many robots as one picture: dark blue is little, light blue much, brown hidden or
// rejected. Squares are written as pixels, which takes a tenth of the time that rectangles take.

import { el, colour, Surface } from "../frame/dom.js";

const EDGE = 31; // CSS pixels for names at the left and the top

/** A canvas with `draw(matrix, names, chosen, cursor)`; calls `choose(a, b)` and `hover([a, b])`. */
export class HeatMap {
  constructor({ choose, hover }) {
    const canvas = el("canvas");
    this.told = null;
    this.element = el("div", "heat view", canvas);
    this.element.tabIndex = 0;
    this.element.setAttribute("role", "img");
    this.surface = new Surface(canvas, (ctx, w, h) => this.paint(ctx, w, h));
    const at = (e) => this.cellAt(this.surface.at(e));
    canvas.addEventListener("pointerup", (e) => {
      const cell = at(e);
      if (cell && cell[0] !== cell[1]) choose(...cell);
    });
    canvas.addEventListener("pointermove", (e) => hover(at(e)));
    canvas.addEventListener("pointerleave", () => hover(null));
    this.element.addEventListener("keydown", (e) => {
      if (e.key === "Enter" && this.told) {
        choose(...this.told.cursor);
        e.preventDefault();
        e.stopPropagation();
      }
    });
  }

  draw(matrix, names, chosen, cursor) {
    this.told = { matrix, names, chosen, cursor };
    this.surface.draw();
  }

  /** Device pixels per cell, and CSS pixels per device pixel. */
  size(width, height) {
    const ratio = window.devicePixelRatio || 1;
    const room = Math.min(width, height) - EDGE - 2;
    const cell = Math.max(1, Math.floor((room * ratio) / this.told.names.length));
    return { cell, css: cell / ratio, ratio };
  }

  cellAt([x, y]) {
    if (!this.told) return null;
    const { css } = this.size(this.surface.width, this.surface.height),
      n = this.told.names.length;
    const cell = [Math.floor((y - EDGE) / css), Math.floor((x - EDGE) / css)];
    return cell.every((k) => k >= 0 && k < n) ? cell : null;
  }

  paint(ctx, width, height) {
    if (!this.told || width < EDGE + 20) return;
    const { cell, css, ratio } = this.size(width, height);
    const shows = [this.told.matrix, cell, document.documentElement.dataset.theme];
    if (shows.some((value, k) => value !== this.shows?.[k]))
      [this.shows, this.picture] = [shows, squares(ctx, this.told.matrix, cell)];
    ctx.putImageData(this.picture, Math.round(EDGE * ratio), Math.round(EDGE * ratio));
    this.mark(ctx, css);
    this.names(ctx, css);
  }

  mark(ctx, css) {
    const { names, chosen, cursor } = this.told,
      size = names.length * css;
    ctx.lineWidth = 1;
    ctx.strokeStyle = colour("focus");
    ctx.strokeRect(EDGE + cursor[1] * css - 1, EDGE + cursor[0] * css - 1, css + 1, css + 1);
    if (!chosen) return;
    ctx.strokeStyle = colour("red-text");
    for (const k of chosen) {
      ctx.strokeRect(EDGE + k * css - 0.5, EDGE - 0.5, css, size);
      ctx.strokeRect(EDGE - 0.5, EDGE + k * css - 0.5, size, css);
    }
    ctx.fillStyle = colour("red");
    for (const [a, b] of [chosen, [chosen[1], chosen[0]]]) {
      ctx.fillRect(EDGE + b * css - 1, EDGE + a * css - 1, css + 1, css + 1);
      ctx.fillStyle = "#fff";
      ctx.fillRect(EDGE + b * css + css / 2 - 1.5, EDGE + a * css + css / 2 - 1.5, 2, 2);
      ctx.fillStyle = colour("red");
    }
  }

  /** As many names as fit; the selected always. */
  names(ctx, css) {
    const { names, chosen } = this.told;
    ctx.font = "500 11px Inter, sans-serif";
    ctx.textBaseline = "middle";
    const every = Math.max(1, Math.ceil(30 / css)),
      far = (k) => !chosen || chosen.every((c) => Math.abs(c - k) * css >= 30);
    names.forEach((name, k) => {
      const own = chosen?.includes(k);
      if (!own && (k % every || !far(k))) return;
      ctx.fillStyle = own ? colour("red-text") : colour("dim");
      const place = EDGE + (k + 0.5) * css,
        nudge =
          own && Math.abs(chosen[0] - chosen[1]) * css < 26 ? (k === Math.min(...chosen) ? -12 : 12) : 0;
      ctx.textAlign = "center";
      ctx.fillText(short(name), place + nudge, EDGE - 10);
      ctx.textAlign = "right";
      ctx.fillText(short(name), EDGE - 5, place + nudge / 2);
    });
  }
}

const short = (name) => (name.length > 5 ? `${name.slice(0, 4)}…` : name);

function rgb(hex) {
  const value = parseInt(hex.slice(1), 16);
  return (255 << 24) | ((value & 255) << 16) | (value & 0xff00) | (value >> 16);
}

/** All cells as squares with a gap, in one picture. */
function squares(ctx, matrix, cell) {
  const n = matrix.n,
    side = n * cell,
    inner = cell > 3 ? cell - 1 : cell;
  const picture = ctx.createImageData(side, side),
    words = new Uint32Array(picture.data.buffer);
  words.fill(rgb(colour("heat-gap")));
  const tones = palette(matrix);
  for (let a = 0; a < n; a++)
    for (let b = 0; b < n; b++) {
      const place = a === b ? -1 : matrix.place(a, b);
      const paint = a === b ? tones.self : tones.of(matrix.values[place], matrix.states[place]);
      for (let y = 0; y < inner; y++)
        words.fill(paint, (a * cell + y) * side + b * cell, (a * cell + y) * side + b * cell + inner);
      if (place >= 0 && matrix.states[place] & 96 && inner > 4)
        frame(words, side, a * cell, b * cell, inner, tones.mark);
    }
  return picture;
}

/** Cells with clicks, or asked about, have an edge. */
function frame(words, side, y, x, inner, paint) {
  words.fill(paint, y * side + x, y * side + x + inner);
  words.fill(paint, (y + inner - 1) * side + x, (y + inner - 1) * side + x + inner);
  for (let k = 0; k < inner; k++) words[(y + k) * side + x] = words[(y + k) * side + x + inner - 1] = paint;
}

function palette({ values, states }) {
  let most = 1e-9;
  for (let k = 0; k < values.length; k++) if (!(states[k] & 128) && values[k] > most) most = values[k];
  const unknown = rgb(colour("heat-none")),
    known = rgb(colour("heat-known")),
    hidden = rgb(colour("heat-hidden"));
  const from = [40, 84, 116],
    to = [196, 230, 250];
  const blues = Array.from({ length: 64 }, (_, k) => {
    const [r, g, b] = from.map((v, c) => Math.round(v + ((to[c] - v) * k) / 63));
    return (255 << 24) | (b << 16) | (g << 8) | r;
  });
  const of = (value, bits) => {
    if (!(bits & 3)) return unknown;
    if ((bits & 3) === 1) return known;
    if (bits & 128 || Number.isNaN(value)) return hidden;
    return blues[Math.min(63, Math.floor((63 * value) / most))];
  };
  return { of, self: rgb(colour("heat-self")), mark: rgb(colour("heat-mark")) };
}
