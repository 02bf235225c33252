// Where the crosses go by themselves: to the guess after the first click, to what is suggested, to a
// point that does not fit, and to a point of the list. Each only once, so that arrows can correct it;
// a guess that comes after the hand has moved the cross does not take it away.

import { state, watch, react, changed } from "../link/store.js";
import { moveCursor } from "../link/commands.js";

const last = { pair: "", half: "", guess: "", suggestion: "", wrong: "" };

let left = null; // where the cross of the other image was when half a point was picked

/** Follows lists and assistance. */
export function startCursors(reveal) {
  react(["list", "assist", "images"], follow);
  watch(["list", "assist", "images"], reveal);
}

function follow() {
  const { list, assist } = state;
  once("pair", list.pair, () => (state.current = null));
  once("half", list.half?.side, () => {
    activate(list.half ? 1 - list.half.side : 0);
    left = state.cursors[state.active];
  });
  if (state.images[assist.side]) once("guess", assist.expected, () => guess(assist));
  if (state.images[0] && state.images[1]) {
    once("suggestion", assist.suggestion, () => assist.suggestion && both(assist.suggestion, 1));
    once("wrong", assist.wrong, () => assist.wrong && toPoint(assist.wrong.id, assist.wrong.side));
  }
}

/** A guess that comes late does not take the cross from where it was put meanwhile. */
function guess({ side, expected }) {
  const moved = left !== null && String(left) !== String(state.cursors[side]);
  if (!expected?.pixel || moved) return;
  moveCursor(side, expected.pixel);
  left = state.cursors[side];
}

function once(what, value, deed) {
  const now = JSON.stringify(value ?? null);
  if (last[what] === now) return;
  last[what] = now;
  deed();
}

/** Keys work in a side's image from now on. */
export function activate(side) {
  state.active = side;
  changed("active");
}

function both({ pi, pj }, active) {
  moveCursor(0, pi, false);
  moveCursor(1, pj, false);
  activate(active);
}

/** The crosses of both images on a point of the list. */
export function toPoint(id, active = state.active) {
  const point = state.list.points.find((p) => p.id === id);
  if (!point || point.other_view) return;
  state.current = id;
  if (point.pi) moveCursor(0, point.pi, false);
  if (point.pj) moveCursor(1, point.pj, false);
  activate(active);
  changed("list");
}
