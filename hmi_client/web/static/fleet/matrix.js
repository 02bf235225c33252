// The symmetric matrix of all pairs: a grid of words up to 24 robots, above that a heat map. A line
// below says in words what the pair under the cursor is.

import { el, onPress, say } from "../frame/dom.js";
import { state, watch, selected, nameOf, lengthText } from "../link/store.js";
import { run } from "../link/commands.js";
import { HeatMap } from "./heat.js";

const panel = document.getElementById("matrix");
const grid = panel.querySelector(".grid"),
  title = panel.querySelector(".title"),
  limit = panel.querySelector(".limit");
const readout = document.getElementById("readout");
export const MOST_WORDS = 24;
const BOLD_SHARE = 0.05;
const TITLES = {
  rms: "Errors of pairs",
  sigma: "Sigma of poses",
  regression: "Errors by the fleet's solution",
  overlap: "Overlap, %",
  age: "Age, s",
  verdict: "Verdicts",
  grave: "Chance of a grave error, %",
};
let heat = null,
  cursor = [0, 1],
  built = "",
  cells = [];

/** Draws on each change; gives `step(dx, dy)` for the arrows. */
export function startMatrix() {
  heat = new HeatMap({ choose, hover });
  watch(["matrix", "names", "selection", "mode", "theme", "welcome"], draw);
  watch(["list"], () => say(limit, state.list.threshold_m ? `- above ${lengthText(state.list.threshold_m)}` : ""));
  return { step };
}

function draw() {
  const { matrix, names } = state;
  if (!matrix || matrix.n !== names.length) return;
  const words = names.length <= MOST_WORDS;
  panel.classList.toggle("heat", !words);
  const key = `${words}${names.join()}`;
  if (key !== built) build(key, words);
  const chosen = selected()?.map((name) => names.indexOf(name)) ?? null;
  if (chosen && String(chosen) !== panel.dataset.pair && !panel.contains(document.activeElement))
    cursor = chosen;
  panel.dataset.pair = String(chosen);
  say(title, heading());
  if (words) fill(chosen);
  else heat.draw(matrix, names, chosen, cursor);
  tell();
}

const quantity = () => state.welcome?.quantities[state.matrix.quantity]?.id ?? "rms";

function isError() {
  return ["rms", "sigma", "regression"].includes(quantity());
}

/** Centimetres while every shown error is below a metre. */
function unit() {
  let most = 0;
  const { values, states } = state.matrix;
  for (let k = 0; k < values.length; k++) if (!(states[k] & 128) && values[k] > most) most = values[k];
  return most < 1 ? "cm" : "m";
}

const heading = () => (isError() ? `${TITLES[quantity()]}, ${unit()}` : TITLES[quantity()]);

function build(key, words) {
  built = key;
  cells = [];
  grid.replaceChildren(words ? table() : heat.element);
  cursor = [0, Math.min(1, state.names.length - 1)];
}

function table() {
  const { names } = state;
  const body = el("table");
  body.setAttribute("role", "grid");
  body.setAttribute("aria-label", "Errors of pairs");
  body.dataset.keys = "own";
  body.append(el("tr", "", el("td"), ...names.map((name) => head(name, "col"))));
  names.forEach((name, a) => {
    const row = names.map((_, b) => {
      const cell = el("td");
      cell.setAttribute("role", "gridcell");
      cell.dataset.at = `${a},${b}`;
      return cell;
    });
    cells.push(row);
    body.append(el("tr", "", head(name, "row"), ...row));
  });
  onPress(body, (e) => {
    const at = e.target.closest("[data-at]")?.dataset.at;
    if (at) {
      cursor = at.split(",").map(Number);
      choose(...cursor);
    }
  });
  body.addEventListener("pointerover", (e) => {
    const at = e.target.closest("[data-at]")?.dataset.at;
    if (at) tell(at.split(",").map(Number));
  });
  body.addEventListener("pointerleave", () => tell());
  body.addEventListener("keydown", gridKey);
  return body;
}

const head = (name, scope) => {
  const node = el("th", "", name);
  node.scope = scope;
  return node;
};

function gridKey(e) {
  const way = { ArrowUp: [0, -1], ArrowDown: [0, 1], ArrowLeft: [-1, 0], ArrowRight: [1, 0] }[e.key];
  const far = e.shiftKey ? 8 : 1;
  if (way) step(way[0] * far, way[1] * far);
  else if (e.key === "Enter" || e.key === " ") choose(...cursor);
  else return;
  e.preventDefault();
}

/** The text of a cell and the classes that draw it. */
export function cellText(cell, bold, inMetres) {
  if (cell.state === "unknown") return ["·", "faint", ""];
  if (cell.state === "known") return ["~", "faint", ""];
  if (cell.hidden || Number.isNaN(cell.value)) return ["-", "faint", ""];
  const doubt = isError() && cell.verdict !== "verified" ? "?" : "";
  return [number(cell.value, inMetres), `${doubt ? "weak" : ""}${bold ? " bold" : ""}`, doubt];
}

function number(value, inMetres) {
  if (isError()) return inMetres ? value.toFixed(2) : (100 * value).toFixed(1);
  return quantity() === "age" ? value.toFixed(0) : (100 * value).toFixed(0);
}

/** The largest errors are bold: above this value. */
function boldFrom() {
  const { values, states } = state.matrix;
  const shown = [...values]
    .filter((v, k) => (states[k] & 3) === 2 && !(states[k] & 128) && !Number.isNaN(v))
    .sort((a, b) => b - a);
  return shown[Math.max(1, Math.floor(BOLD_SHARE * shown.length)) - 1] ?? Infinity;
}

function fill(chosen) {
  const { matrix } = state,
    bold = isError() ? boldFrom() : Infinity,
    metres = unit() === "m";
  grid.firstChild
    .querySelectorAll("th")
    .forEach((node, k) => node.classList.toggle("red", !!chosen?.includes(k % state.names.length)));
  cells.forEach((row, a) =>
    row.forEach((node, b) => {
      const cell = a === b ? null : matrix.at(a, b);
      const [text, classes, doubt] = cell ? cellText(cell, cell.value >= bold, metres) : ["╲", "self", ""];
      const red = chosen && a !== b && chosen.includes(a) && chosen.includes(b);
      const now = `${text}|${classes}|${doubt}|${red}|${cell?.clicked}|${cell?.asked}`;
      if (node.dataset.words !== now) paintCell(node, now, text, classes, doubt, red, cell);
      node.tabIndex = a === cursor[0] && b === cursor[1] ? 0 : -1;
    }),
  );
}

function paintCell(node, now, text, classes, doubt, red, cell) {
  node.dataset.words = now;
  node.className = `${classes}${red ? " red" : ""}${cell?.clicked ? " clicked" : ""}${cell?.asked ? " asked" : ""}`;
  node.replaceChildren(text, ...(doubt ? [el("small", "", doubt)] : []));
}

/** Moves the cursor of grid or heat map. */
function step(dx, dy) {
  const n = state.names.length,
    clamp = (x) => Math.min(Math.max(x, 0), n - 1);
  if (n < 2) return false;
  cursor = [clamp(cursor[0] + dy), clamp(cursor[1] + dx)];
  draw();
  cells[cursor[0]]?.[cursor[1]]?.focus();
  return true;
}

function choose(a, b) {
  cursor = [a, b];
  if (a !== b) run("select", { a: state.names[a], b: state.names[b] });
  draw();
}

function hover(at) {
  tell(at ?? undefined);
}

/** The pair in words: "r3 – r8  1.24 m (hidden), ambiguous". */
function tell(at) {
  const chosen = selected()?.map((name) => state.names.indexOf(name));
  const [a, b] = at ?? (panel.contains(document.activeElement) ? cursor : (chosen ?? cursor));
  if (a === b || !state.matrix || a >= state.matrix.n || b >= state.matrix.n || a < 0 || b < 0) return;
  const pair = `${nameOf(Math.min(a, b))} – ${nameOf(Math.max(a, b))}`,
    text = ` ${cellWords(state.matrix.at(a, b))}`;
  const own = !!chosen?.includes(a) && chosen.includes(b);
  if (readout.dataset.words === pair + text + own) return;
  readout.dataset.words = pair + text + own;
  readout.replaceChildren(el("b", own ? "red" : "", pair), text);
  if (panel.classList.contains("heat")) heat.element.setAttribute("aria-label", pair + text);
}

function cellWords(cell) {
  const words = { unknown: "never tried", known: "known only through others" }[cell.state];
  if (words) return `${words}${cell.asked ? ", asked" : ""}`;
  const value = Number.isNaN(cell.value)
    ? "no value"
    : isError()
      ? lengthText(cell.value)
      : `${TITLES[quantity()].toLowerCase()} ${number(cell.value)}`;
  return [
    `${value}${cell.hidden ? " (hidden)" : ""}`,
    cell.verdict,
    cell.clicked ? "has clicks" : "",
    cell.asked ? "asked" : "",
  ]
    .filter(Boolean)
    .join(", ");
}
