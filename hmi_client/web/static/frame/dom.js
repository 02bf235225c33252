// Elements and canvases. Words of others enter the page only as text.

/** An element of a class with children; strings become text. */
export function el(tag, className = "", ...children) {
  const node = document.createElement(tag);
  if (className) node.className = className;
  node.append(...children.filter((child) => child !== null && child !== undefined));
  return node;
}

const TAP = 16; // CSS pixels that a finger may roll: what Chromium and Android allow is 15

/** A button that shows its key. */
export function button(className, label, key, click) {
  const node = el("button", className, label);
  if (key) node.append(el("kbd", "", key));
  node.type = "button";
  return onPress(node, click);
}

/** What a mouse, a key or a finger on a button (or on what lies in it) does; returns the node. */
export function onPress(node, deed) {
  node.addEventListener("click", deed);
  onTap(node, deed);
  return node;
}

/** A tap counts as the finger is lifted: browsers make no click of one that soon follows a drag. */
function onTap(node, deed) {
  let from = null;
  const place = ({ clientX, clientY }) => [clientX, clientY];
  node.addEventListener(
    "touchstart",
    (e) => (from = e.touches.length === 1 ? place(e.touches[0]) : null),
    { passive: true },
  );
  node.addEventListener("touchcancel", () => (from = null));
  node.addEventListener("touchend", (e) => {
    if (!from || node.disabled) return;
    const [x, y] = place(e.changedTouches[0]);
    if (Math.hypot(x - from[0], y - from[1]) > TAP) return;
    e.preventDefault(); // no click as well, which might meet what comes in this button's place
    deed(e);
  });
}

/** Sets text only where it differs, so that nothing is laid out or spoken anew. */
export function say(node, text) {
  if (node.textContent !== text) node.textContent = text;
}

/** A canvas that follows its box at the screen's resolution; `draw(ctx, width, height)` in CSS pixels. */
export class Surface {
  constructor(canvas, draw) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d");
    this.paint = draw;
    this.width = this.height = 0;
    new ResizeObserver(() => this.measure()).observe(canvas.parentElement);
  }

  measure() {
    const box = this.canvas.parentElement.getBoundingClientRect();
    this.width = box.width;
    this.height = box.height;
    this.draw();
  }

  draw() {
    if (!this.width || !this.height) return;
    const ratio = window.devicePixelRatio || 1;
    const [w, h] = [Math.round(this.width * ratio), Math.round(this.height * ratio)];
    if (this.canvas.width !== w || this.canvas.height !== h) [this.canvas.width, this.canvas.height] = [w, h];
    this.context.setTransform(w / this.width, 0, 0, h / this.height, 0, 0);
    this.context.clearRect(0, 0, this.width, this.height);
    this.paint(this.context, this.width, this.height);
  }

  /** Where a pointer is, in CSS pixels of the canvas. */
  at(event) {
    const box = this.canvas.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  }
}

const root = getComputedStyle(document.documentElement);
const colours = new Map(); // by theme and role: asking the style costs more than drawing

/** A colour of the theme by its role. */
export function colour(role) {
  const { theme } = document.documentElement.dataset;
  const name = `${theme} ${role}`;
  if (!colours.has(name)) colours.set(name, root.getPropertyValue(`--${role}`).trim());
  return colours.get(name);
}
