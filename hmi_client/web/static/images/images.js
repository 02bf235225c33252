// The two images: where pixels are on the screen, and what pointers do there. A click brings the
// cross; picking is the loupe's or a key's.

import { el, say, Surface } from "../frame/dom.js";
import { state, watch, changed, selected, broken, ageText } from "../link/store.js";
import { run, moveCursor } from "../link/commands.js";
import { Loupe } from "./loupe.js";
import { marksOf, drawMarks, hairlines, nearest, tagOf, depthAt } from "./marks.js";

const REACH = { mouse: 12, pen: 12, touch: 24 }; // CSS pixels around a mark
const MANY = 50,
  DRAG = 4,
  MOST_ZOOM = 32;

/** One robot's image with its loupe. */
export class ImagePanel {
  constructor(side) {
    this.side = side;
    this.zoom = 1;
    this.centre = null;
    this.pointers = new Map();
    const heading = el(
      "h2",
      "",
      (this.robot = el("span", "robot")),
      (this.tag = el("span", "tag")),
      (this.view = el("span", "dim wide")),
      (this.place = el("span", "place dim")),
      el("em", "stamp"),
    );
    const canvas = el("canvas", "photo"),
      fine = el("canvas", "loupe");
    this.empty = el("p", "empty");
    this.pictures = el(
      "div",
      "pictures",
      el("div", "view", canvas, this.empty),
      (this.loupeBox = el("div", "view", fine)),
    );
    this.section = el("section", "panel image", heading, this.pictures);
    this.section.dataset.panel = side ? "right" : "left";
    this.section.tabIndex = 0;
    this.surface = new Surface(canvas, (ctx, w, h) => this.paint(ctx, w, h));
    this.loupe = new Loupe(side, fine, this.loupeBox);
    this.listen(canvas);
    this.section.addEventListener("focus", () => {
      if (state.active !== side) {
        state.active = side;
        changed("active");
      }
    });
    new ResizeObserver(() => this.divide()).observe(this.pictures);
    const fleet = ["list", "assist", "names", "link", "tick"];
    const view = ["images", `image ${side}`, "cursors", `cursor ${side}`, "active", "marks", "theme", "mode"];
    watch([...fleet, ...view], () => this.draw());
  }

  /** CSS pixels per image pixel. */
  scale() {
    const image = state.images[this.side];
    return this.zoom * Math.min(this.surface.width / image.width, this.surface.height / image.height);
  }

  /** Image pixel to CSS pixels; the centre of the top-left pixel is (0, 0). */
  toScreen = ([u, v]) => {
    const s = this.scale(),
      [cu, cv] = this.middle();
    return [this.surface.width / 2 + (u - cu) * s, this.surface.height / 2 + (v - cv) * s];
  };

  toImage([x, y]) {
    const s = this.scale(),
      [cu, cv] = this.middle();
    return [cu + (x - this.surface.width / 2) / s, cv + (y - this.surface.height / 2) / s];
  }

  /** The image pixel in the middle of the view; it never shows more border than must be. */
  middle() {
    const { width, height } = state.images[this.side],
      s = this.scale();
    const keep = (c, size, box) => {
      const half = Math.min(box / s / 2, size / 2);
      return Math.min(Math.max(c, half - 0.5), size - 0.5 - half);
    };
    const [u, v] = this.centre ?? [(width - 1) / 2, (height - 1) / 2];
    return [keep(u, width, this.surface.width), keep(v, height, this.surface.height)];
  }

  /** The loupe takes what the image leaves, and at least a third. */
  divide() {
    const image = state.images[this.side];
    const aspect = image ? image.width / image.height : 1.5;
    const { width, height } = this.pictures.getBoundingClientRect();
    const loupe = Math.min(Math.max(width - height * aspect - 2, 0.3 * width), 0.46 * width);
    this.pictures.style.setProperty("--loupe", `${Math.round(loupe)}px`);
  }

  draw() {
    const image = state.images[this.side],
      names = selected(),
      side = this.side,
      gone = broken();
    const [tag, now] = tagOf(side),
      cursor = state.cursors[side];
    say(this.robot, names ? names[side] : "–");
    say(this.tag, gone ? "" : tag);
    this.tag.classList.toggle("now", now);
    say(
      this.view,
      image
        ? `view ${image.view}, ${gone ? `${ageText(gone.age)} old` : state.list.frozen ? "held" : "live"}`
        : "",
    );
    say(this.place, image && cursor ? placeText(side, cursor) : "");
    say(this.empty, image ? "" : names ? `No image of ${names[side]} yet` : "");
    this.section.setAttribute("aria-label", `Image of ${names ? names[side] : "no robot"}`);
    this.section.classList.toggle("active", state.active === side);
    if (image && this.size !== `${image.width}x${image.height}`) {
      this.size = `${image.width}x${image.height}`;
      this.divide();
    }
    this.surface.draw();
    this.loupe.draw();
  }

  paint(ctx, width, height) {
    const image = state.images[this.side];
    if (!image) return;
    const s = this.scale(),
      [x, y] = this.toScreen([-0.5, -0.5]);
    ctx.imageSmoothingEnabled = s < 2;
    ctx.drawImage(image.bitmap, x, y, image.width * s, image.height * s);
    const cursor = state.cursors[this.side],
      both = state.assist.suggestion;
    if (cursor && (both || state.active === this.side) && !state.marksHidden)
      hairlines(ctx, this.toScreen(cursor), width, height);
    this.marks(ctx, width, height);
  }

  /** Many marks are drawn once, on a sheet of their own that is laid over the image until they change;
   * those that wait for the server are drawn over it, for they come and go with each click.
   */
  marks(ctx, width, height) {
    const marks = marksOf(this.side);
    if (marks.points.length < MANY || state.marksHidden) return drawMarks(ctx, marks, this.toScreen, width);
    const known = marks.points.filter((p) => p.id !== null),
      waiting = marks.points.filter((p) => p.id === null);
    const place = [this.scale(), ...this.middle(), ctx.canvas.width, ctx.canvas.height];
    const shows = JSON.stringify([known, place]);
    this.sheet ??= { canvas: el("canvas"), shows: "" };
    const { canvas } = this.sheet;
    if (shows !== this.sheet.shows) {
      [canvas.width, canvas.height] = [ctx.canvas.width, ctx.canvas.height];
      const over = canvas.getContext("2d");
      over.setTransform(ctx.getTransform());
      drawMarks(over, { points: known, hints: [] }, this.toScreen, width);
      this.sheet.shows = shows;
    }
    ctx.drawImage(canvas, 0, 0, width, height);
    drawMarks(ctx, { ...marks, points: waiting }, this.toScreen, width);
  }

  listen(canvas) {
    canvas.addEventListener("pointerdown", (e) => this.down(e));
    canvas.addEventListener("pointermove", (e) => this.moved(e));
    canvas.addEventListener("pointerup", (e) => this.up(e));
    canvas.addEventListener("pointercancel", (e) => this.pointers.delete(e.pointerId));
    canvas.addEventListener(
      "wheel",
      (e) => {
        e.preventDefault();
        this.zoomBy(Math.exp(-e.deltaY / 400), this.surface.at(e));
      },
      { passive: false },
    );
  }

  down(e) {
    if (!state.images[this.side] || e.button > 0) return;
    e.currentTarget.setPointerCapture(e.pointerId);
    this.pointers.set(e.pointerId, {
      at: this.surface.at(e),
      from: this.surface.at(e),
      dragged: this.pointers.size > 0,
    });
  }

  moved(e) {
    const pointer = this.pointers.get(e.pointerId);
    if (!pointer || !state.images[this.side]) return;
    const at = this.surface.at(e),
      before = pointer.at;
    pointer.dragged ||= Math.hypot(at[0] - pointer.from[0], at[1] - pointer.from[1]) > DRAG;
    if (!pointer.dragged) return;
    pointer.at = at;
    if (this.pointers.size === 1) this.panBy(at[0] - before[0], at[1] - before[1]);
    else this.pinch(e.pointerId, before, at);
  }

  pinch(id, before, at) {
    const [, other] = [...this.pointers].find(([key]) => key !== id);
    other.dragged = true;
    const reach = ([x, y]) => Math.hypot(x - other.at[0], y - other.at[1]) || 1;
    const middle = ([x, y]) => [(x + other.at[0]) / 2, (y + other.at[1]) / 2];
    const [was, now] = [middle(before), middle(at)];
    this.zoomBy(reach(at) / reach(before), was);
    this.panBy(now[0] - was[0], now[1] - was[1]); // what lies between the fingers goes with them
  }

  up(e) {
    const pointer = this.pointers.get(e.pointerId);
    this.pointers.delete(e.pointerId);
    if (!pointer || pointer.dragged || !state.images[this.side]) return;
    const mark = nearest(marksOf(this.side), this.toScreen, this.surface.at(e), REACH[e.pointerType] ?? 12);
    state.current = mark?.id ?? null;
    moveCursor(this.side, this.toImage(this.surface.at(e)));
    this.section.focus({ preventScroll: true });
    if (e.shiftKey) run("snap");
    changed("list");
  }

  /** For labels: how far apart they can be read, and the part of the image in sight; image pixels. */
  inSight() {
    const s = this.scale(),
      { width, height } = this.surface;
    return {
      apart: [40 / s, 24 / s],
      within: [...this.toImage([0, 0]), ...this.toImage([width, height])],
    };
  }

  panBy(dx, dy) {
    const s = this.scale(),
      [u, v] = this.middle();
    this.centre = [u - dx / s, v - dy / s];
    this.surface.draw();
  }

  /** Zooms so that what lies under `at` stays there. */
  zoomBy(factor, at) {
    if (!state.images[this.side]) return;
    const held = this.toImage(at);
    this.zoom = Math.min(Math.max(this.zoom * factor, 1), MOST_ZOOM);
    const s = this.scale();
    this.centre = [
      held[0] - (at[0] - this.surface.width / 2) / s,
      held[1] - (at[1] - this.surface.height / 2) / s,
    ];
    this.surface.draw();
  }

  /** Brings the cross back into view. */
  reveal() {
    if (!state.images[this.side] || !state.cursors[this.side]) return;
    const [x, y] = this.toScreen(state.cursors[this.side]);
    if (x < 0 || y < 0 || x > this.surface.width || y > this.surface.height)
      this.centre = state.cursors[this.side];
  }

  fit() {
    this.zoom = 1;
    this.centre = null;
    this.surface.draw();
  }
}

function placeText(side, cursor) {
  const depth = depthAt(side, cursor);
  const pixel = `${cursor[0].toFixed(1)}, ${cursor[1].toFixed(1)} px`;
  return depth ? `${pixel} · ${depth.toFixed(1)} m deep` : pixel;
}
