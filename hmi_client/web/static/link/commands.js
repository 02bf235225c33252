// Every deed by its id in the keymap: those of the page are done here, all others are sent.

import { state, put, changed, broken } from "./store.js";
import { send } from "./socket.js";

const own = new Map();
let cursorDue = new Set();

/** Registers a command that the page itself does. */
export function command(id, deed) {
  own.set(id, deed);
}

/** Does a command; where the bar offers it, with the bar's arguments. */
export function run(id, args = {}) {
  return own.has(id) ? own.get(id)(args) : sendAs(id, args);
}

/** Sends a command, whoever does it else. */
export function sendAs(id, args = {}) {
  if (broken()?.leg === "page")
    return tell("Not connected to hmi-client web: nothing can be done until it is back.");
  flushCursors();
  const offered = (state.step?.actions ?? []).find((action) => action.do === id);
  const message = { do: id, ...aim(id), ...(offered?.args ?? {}), ...args };
  if (message.do === "pick" && !imageOf(message.side)) return tell("There is no image to pick in yet.");
  if (id === "pick") echo(message);
  if (id === "go") state.dismissed = "";
  return send(message);
}

/** A sentence in the foot of the page. */
export function tell(text) {
  put("notice", { t: "notice", text, tone: "warn", at: performance.now() });
  return false;
}

/** Labels that were used, or left, do not come back until they are asked for anew. */
export function dismissHints() {
  state.dismissed = JSON.stringify(state.assist.hints);
  state.assist = { ...state.assist, hints: [] };
  put("typed", "");
  changed("assist");
}

const imageOf = (side) => state.images[side];

/** Where a command works: the cursor of the active image. */
function aim(id) {
  if (!["pick", "snap", "move", "erase", "go"].includes(id)) return {};
  const side = state.active;
  const place = { side, pixel: state.cursors[side] };
  const view = imageOf(side)?.view,
    beside = imageOf(1 - side)?.view;
  if (id === "pick") return { ...place, view, beside }; // what lies before the eyes is what is held
  if (id === "erase" && state.current !== null) return { id: state.current };
  return view === undefined || id === "erase" || id === "move" ? place : { ...place, view };
}

/** A click is drawn at once, before anybody heard of it; the list that answers it replaces it. */
function echo({ side, pixel }) {
  const { half, points } = state.list;
  if (half && half.side !== side) {
    const whole = points.filter((p) => p.status !== "half");
    state.list = { ...state.list, half: null, points: [...whole, joined(half, { side, pixel })] };
  } else state.list = { ...state.list, half: { side, pixel } };
  changed("list");
}

/** The point of two halves, as the bridge will tell it. */
function joined(half, other) {
  const { points } = state.list;
  const known = points.find((p) => p.status === "half");
  const [pi, pj] = half.side ? [other.pixel, half.pixel] : [half.pixel, other.pixel];
  const unknown = { reason: null, residual_m: null, depth_i: null, depth_j: null, other_view: false };
  const n = known?.n ?? 1 + Math.max(0, ...points.map((p) => p.n));
  return { ...unknown, n, id: null, status: "pending", pi, pj, by: state.welcome?.operator };
}

/** Moves a cursor; the bridge hears the newest place before any other command. */
export function moveCursor(side, pixel, toActive = true) {
  const image = imageOf(side);
  if (!image) return;
  const clamp = (x, size) => Math.min(Math.max(x, -0.5), size - 0.5);
  state.cursors[side] = [clamp(pixel[0], image.width), clamp(pixel[1], image.height)];
  if (toActive && state.active !== side) {
    state.active = side;
    changed("active");
  }
  cursorDue.add(side);
  if (cursorDue.size === 1) requestAnimationFrame(flushCursors);
  changed(`cursor ${side}`);
}

function flushCursors() {
  for (const side of cursorDue) send({ do: "cursor", side, pixel: state.cursors[side] });
  cursorDue = new Set();
}
