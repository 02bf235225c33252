// Keys: which command a key is, by the keymap of hmi-client. Tab is taken only while a suggestion is
// shown, and Esc gives it back, so that nobody is caught in a panel.

import { state, watch, changed, put } from "../link/store.js";
import { run, moveCursor, dismissHints } from "../link/commands.js";
import { primaryAction } from "./bar.js";

const NAMES = { " ": "space", ArrowUp: "up", ArrowDown: "down", ArrowLeft: "left", ArrowRight: "right" };
const PRINTED = { space: "Space", enter: "Enter", tab: "Tab", "shift+tab": "⇧Tab", escape: "Esc" };
const ARROWS = { up: [0, -1], down: [0, 1], left: [-1, 0], right: [1, 0] };
let released = null; // the suggestion whose Tab was given back

/** A key as it is printed on a keyboard. */
export function printed(key) {
  if (PRINTED[key]) return PRINTED[key];
  return /^[A-Z]$/.test(key) ? `⇧${key}` : key.length === 1 ? key.toUpperCase() : key;
}

export const entries = () => state.welcome?.keymap ?? [];

/** The keys of an entry as a list. */
export const keysOf = (entry) => entry.keys;

/** The first key of a command, printed; empty if it has none. */
export function keyOf(id) {
  const entry = entries().find((e) => e.id === id);
  return entry ? printed(keysOf(entry)[0]) : "";
}

/** Listens to all keys of the page. */
export function startKeys(places) {
  document.addEventListener("keydown", (e) => pressed(e, places));
  document.addEventListener("keyup", (e) => {
    if (e.key.toLowerCase() === "h") hideMarks(false);
  });
  window.addEventListener("blur", () => hideMarks(false));
  watch(["assist"], () => {
    if (!state.assist.suggestion) released = null;
    if (!state.assist.hints.length && state.typed) put("typed", "");
  });
}

function hideMarks(hidden) {
  if (state.marksHidden === hidden) return;
  state.marksHidden = hidden;
  changed("marks");
}

function named(e) {
  const name = NAMES[e.key] ?? (e.key.length === 1 ? e.key : e.key.toLowerCase());
  return e.shiftKey && (name === "tab" || name in ARROWS) ? `shift+${name}` : name;
}

function pressed(e, places) {
  if (e.ctrlKey || e.metaKey || e.altKey || document.querySelector("dialog[open]")) return;
  const key = named(e),
    at = document.activeElement;
  if (/^(INPUT|SELECT|TEXTAREA)$/.test(at?.tagName)) return;
  if (hinted(e, key)) return;
  const onButton = at?.tagName === "BUTTON" && (key === "enter" || key === "space");
  const ownKeys =
    at?.closest("[data-keys]") && (ARROWS[key.replace("shift+", "")] || key === "enter" || key === "space");
  if (onButton || ownKeys) return;
  if (taken(key, e, at, places)) e.preventDefault();
}

/** Whether the page takes a key; a tab that is not asked for a suggestion stays the browser's. */
function taken(key, e, at, places) {
  if (key === "escape" && state.assist.suggestion) released = suggestionId();
  if (key.endsWith("tab") && (!state.assist.suggestion || released === suggestionId())) return false;
  if (key.toLowerCase() === "h") {
    hideMarks(true);
    return true;
  }
  const place = placeOf(at);
  const arrow = ARROWS[key.replace("shift+", "")];
  if (arrow) return nudge(arrow, e.shiftKey ? 10 : 1, place, places);
  const entry = find(key, place);
  if (key === "enter" && (!at || at === document.body)) return primaryAction();
  if (!entry) return false;
  run(entry.id);
  return true;
}

const suggestionId = () => `${state.list.pair}:${state.assist.suggestion?.n}`;

const PLACES = { map: "map", scene: "map", matrix: "matrix", list: "list", left: "images", right: "images" };
const placeOf = (at) => PLACES[at?.closest("[data-panel]")?.dataset.panel] ?? "images";

/** The entry of a key: of the place where the focus is, then everywhere. */
function find(key, place) {
  const there = (e) => String(e.place ?? "").toLowerCase();
  const has = (e) => keysOf(e).includes(key);
  return (
    entries().find((e) => there(e).startsWith(place.slice(0, 3)) && has(e)) ??
    entries().find((e) => there(e).startsWith("every") && has(e))
  );
}

function nudge([dx, dy], step, place, places) {
  if (place !== "images") return places[place]?.(dx * step, dy * step) ?? false;
  const cursor = state.cursors[state.active];
  if (!cursor) return false;
  moveCursor(state.active, [cursor[0] + dx * step, cursor[1] + dy * step]);
  places.reveal();
  return true;
}

/** Letters of a label bring the cross to its place. */
function hinted(e, key) {
  const { hints } = state.assist;
  if (!hints.length) return false;
  if (key === "escape") dismissHints();
  if (key.length !== 1) return key === "escape";
  const typed = state.typed + key.toLowerCase();
  const left = hints.filter((h) => h.label.toLowerCase().startsWith(typed));
  e.preventDefault();
  put("typed", left.length ? typed : "");
  if (left.length === 1) goTo(left[0]);
  changed("assist");
  return true;
}

function goTo(hint) {
  moveCursor(hint.side, hint.pixel);
  dismissHints();
}
