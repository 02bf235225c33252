// The loupe: 8 CSS pixels per image pixel around the cross. A click picks the place under it; a finger
// moves the picture under the cross. A point that does not fit splits it: clicked above, fitting below.

import { el, Surface } from "../frame/dom.js";
import { state } from "../link/store.js";
import { run, moveCursor } from "../link/commands.js";
import { marksOf, misfitOf, drawMarks, loupeCross } from "./marks.js";

export const LOUPE_ZOOM = 8;
const DRAG = 3;

/** The loupe of one side. */
export class Loupe {
  constructor(side, canvas, box) {
    this.side = side;
    this.captions = [
      el("span", "caption"),
      el("span", "caption low half"),
      el("span", "caption low", `loupe ${LOUPE_ZOOM}×`),
    ];
    box.append(...this.captions);
    this.surface = new Surface(canvas, (ctx, w, h) => this.paint(ctx, w, h));
    canvas.addEventListener("pointerdown", (e) => this.down(e));
    canvas.addEventListener("pointermove", (e) => this.moved(e));
    canvas.addEventListener("pointerup", (e) => this.up(e));
    canvas.addEventListener("pointercancel", () => (this.held = null));
  }

  wrong() {
    return misfitOf(this.side);
  }

  /** The parts from top to bottom: the pixel in their middle, and their height. */
  parts(height) {
    const wrong = this.wrong();
    if (!wrong) return [{ top: 0, height, middle: state.cursors[this.side] }];
    return [
      { top: 0, height: height / 2, middle: wrong.clicked },
      { top: height / 2, height: height / 2, middle: wrong.fits },
    ];
  }

  draw() {
    const split = this.wrong() !== null,
      shown = !!state.images[this.side];
    this.captions[0].textContent = split ? "as you clicked it" : "";
    this.captions[1].textContent = split ? "where the others put it" : "";
    this.captions[2].hidden = !shown;
    this.surface.draw();
  }

  paint(ctx, width, height) {
    const image = state.images[this.side];
    if (!image || !state.cursors[this.side]) return;
    for (const part of this.parts(height)) this.paintPart(ctx, image, part, width);
    if (this.wrong()) {
      ctx.fillStyle = "#000";
      ctx.fillRect(0, height / 2 - 1, width, 2);
    }
  }

  paintPart(ctx, image, { top, height, middle }, width) {
    ctx.save();
    ctx.beginPath();
    ctx.rect(0, top, width, height);
    ctx.clip();
    const centre = [width / 2, top + height / 2];
    const at = ([u, v]) => [
      centre[0] + (u - middle[0]) * LOUPE_ZOOM,
      centre[1] + (v - middle[1]) * LOUPE_ZOOM,
    ];
    ctx.imageSmoothingEnabled = false;
    ctx.drawImage(image.bitmap, ...at([-0.5, -0.5]), image.width * LOUPE_ZOOM, image.height * LOUPE_ZOOM);
    if (!state.marksHidden && !top) loupeCross(ctx, centre, LOUPE_ZOOM);
    drawMarks(ctx, marksOf(this.side), at, width, false);
    ctx.restore();
  }

  /** The image pixel at a place of the canvas. */
  toImage([x, y]) {
    const { width, height } = this.surface;
    const part = this.parts(height).find((p) => y < p.top + p.height) ?? this.parts(height)[0];
    return [
      part.middle[0] + (x - width / 2) / LOUPE_ZOOM,
      part.middle[1] + (y - part.top - part.height / 2) / LOUPE_ZOOM,
    ];
  }

  down(e) {
    if (!state.images[this.side] || e.button > 0) return;
    e.currentTarget.setPointerCapture(e.pointerId);
    const at = this.surface.at(e);
    this.held = { from: at, at, dragged: false, touch: e.pointerType === "touch" };
  }

  /** The picture goes with the pointer, the cross stays. */
  moved(e) {
    if (!this.held || !state.cursors[this.side]) return;
    const at = this.surface.at(e),
      { from } = this.held;
    this.held.dragged ||= Math.hypot(at[0] - from[0], at[1] - from[1]) > DRAG;
    if (!this.held.dragged) return;
    const [u, v] = state.cursors[this.side],
      before = this.held.at;
    this.held.at = at;
    moveCursor(this.side, [u - (at[0] - before[0]) / LOUPE_ZOOM, v - (at[1] - before[1]) / LOUPE_ZOOM]);
  }

  up(e) {
    const held = this.held;
    this.held = null;
    if (!held || held.dragged || !state.images[this.side]) return;
    const place = this.toImage(this.surface.at(e));
    moveCursor(this.side, place);
    const asked = this.wrong() === null; // a split loupe asks for Move or Erase, not for another point
    if (asked && !held.touch) run("pick"); // a finger hides what it points at: the button picks
  }
}
