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
  const view = imageOf(side)?.view;
  if (id === "erase" && state.current !== null) return { id: state.current };
  return view === undefined || id === "erase" || id === "move" ? place : { ...place, view };
}

/** The first click of a pair is drawn at once, before anybody heard of it. */
function echo({ side, pixel }) {
  const half = state.list.half;
  if (half && half.side !== side) return;
  state.list = { ...state.list, half: { side, pixel } };
  changed("list");
}

/** Moves a cursor; the bridge hears the newest place before any other command. */
export function moveCursor(side, pixel, toActive = true) {
  const image = imageOf(side);
  if (!image) return;
  const clamp = (x, size) => Math.min(Math.max(x, -0.5), size - 0.5);
  state.cursors[side] = [clamp(pixel[0], image.width), clamp(pixel[1], image.height)];
  if (toActive) state.active = side;
  cursorDue.add(side);
  if (cursorDue.size === 1) requestAnimationFrame(flushCursors);
  changed("cursors", "active");
}

function flushCursors() {
  for (const side of cursorDue) send({ do: "cursor", side, pixel: state.cursors[side] });
  cursorDue = new Set();
}
