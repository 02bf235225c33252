// The bar: what to do now, why, and at most three buttons with their keys.

import { el, button } from "./dom.js";
import { state, watch, selected, ageText } from "../link/store.js";
import { stepNow, kickText } from "./steps.js";
import { isBad } from "../images/marks.js";
import { run } from "../link/commands.js";
import { keyOf } from "./keys.js";

const bar = document.getElementById("bar");
const touchbar = document.getElementById("touchbar");
const SETTLED_MS = 250; // what has just come under a hand was not meant by it
const since = new WeakMap(); // from when on each button is where it is
let primary = "",
  primaryAt = -SETTLED_MS;
const now = el("div", "now"),
  why = el("dl", "facts"),
  actions = el("div", "actions");
const shown = new Map();

/** Draws the bar whenever its words change, and only then: it is read aloud. */
export function startBar() {
  bar.append(now, why, actions);
  watch(
    ["step", "list", "assist", "questions", "link", "tick", "mode", "names", "poses", "health", "welcome"],
    draw,
  );
}

function draw() {
  const step = stepNow();
  const [left, right] = step.dots ? kickText() : [step.kick, ""];
  const kick = step.kick || left;
  const marks = step.dots ? dots() : [];
  const first = step.actions.find((action) => action.primary)?.do ?? "";
  if (first !== primary) [primary, primaryAt] = [first, from(primary)];
  bar.className = `bar ${step.tone}`;
  fill("now", [kick, right, marks, step.title, selected()], () =>
    now.replaceChildren(
      el("div", "kick", el("span", "", kick), dotRow(marks), el("span", "", right)),
      title(step.title),
    ),
  );
  fill("why", [step.facts, step.legs, step.legs && state.link.ping_ms], () =>
    why.replaceChildren(...facts(step)),
  );
  const keys = step.actions.map((action) => [keyOf(action.do), !!state.assist.suggestion]);
  fill("actions", [step.actions, keys, state.list.undo], () => offer(step));
}

/** Draws a part only when its words change: a button must not go away under a finger. */
function fill(part, words, drawn) {
  const now = JSON.stringify(words);
  if (shown.get(part) === now) return;
  shown.set(part, now);
  drawn();
}

function offer(step) {
  const focused = document.activeElement?.dataset?.deed;
  place(actions, step.actions.map((action) => actionButton(actions, action)));
  place(touchbar, [...step.actions.map((action) => actionButton(touchbar, action)), ...touchButtons(step)]);
  if (focused) document.querySelector(`[data-deed="${CSS.escape(focused)}"]`)?.focus();
}

/** Puts buttons into a box, and notes which have come where one of another deed was. */
function place(box, nodes) {
  const before = [...box.children];
  nodes.forEach((node, k) => {
    const same = before[k] && before[k].dataset.deed === node.dataset.deed;
    since.set(node, same ? since.get(before[k]) : from(before[k]));
  });
  box.replaceChildren(...nodes);
}

/** From when on something counts: at once where nothing was before it, for then no other was meant. */
const from = (before) => (before ? performance.now() : -SETTLED_MS);
const settled = (at) => performance.now() - at > SETTLED_MS;

/** Robots of the selection are red wherever they are named. */
function title(text) {
  const names = selected() ?? [];
  const heading = el("h1");
  const parts = names.length ? text.split(new RegExp(`(${names.map(escape).join("|")})(?![\\w-])`)) : [text];
  heading.append(...parts.map((part, k) => (k % 2 ? el("em", "", part) : part)));
  return heading;
}

const escape = (name) => name.replace(/[.*+?^${}()|[\]\\]/g, "\\$&");

function dots() {
  const { points, half } = state.list;
  const marks = points.slice(0, 8).map((p) => (isBad(p) ? "bad" : p.status === "half" ? "next" : "on"));
  return half && !marks.includes("next") ? [...marks, "next"] : marks;
}

const dotRow = (marks) => (marks.length ? el("span", "dots", ...marks.map((mark) => el("i", mark))) : null);

function facts(step) {
  const list = step.facts
    .slice(0, 3)
    .map(([label, text]) => el("div", "", label ? el("dt", "", label) : null, el("dd", "", kept(sentence(text)))));
  if (step.legs)
    list.push(
      el("div", "legs-fact", el("dt", "", Number.isFinite(step.legs[1] ?? 0) ? "Where it is broken" : "What is connected"), el("dd", "legs", ...legs(step.legs))),
    );
  return list;
}

/** A first letter is large, except of a robot's name. */
const sentence = (text) =>
  state.names.includes(/^[\w-]*/.exec(text)[0]) ? text : text.replace(/^[a-z]/, (c) => c.toUpperCase());
/** A number and its unit stay on one line. */
const kept = (text) => text.replace(/(\d) (?=(?:%|m|cm|s|px)(?:[ .,;)]|$))/g, "$1\u00a0");

/** page - hmi-client web - pose-server, with the broken leg named. */
function legs([page, server]) {
  const { ping_ms } = state.link;
  const leg = (age, ok) =>
    age === null
      ? el("span", "ok", ok)
      : el("span", "bad", Number.isFinite(age) ? `silent ${ageText(age)}` : "not heard yet");
  return [
    el("b", "", "this page"),
    leg(page, ping_ms === null ? "ok" : `${Math.max(1, Math.round(ping_ms))} ms`),
    el("b", "", "hmi-client web"),
    server === null ? el("span", "unknown", "not known") : leg(server, ""),
    el("b", "", "pose-server"),
  ];
}

/** The button of an action in a box: the one that is there already, if it is the same. */
function actionButton(box, action) {
  const taken = action.do === "accept" && !state.assist.suggestion; // Tab is the browser's until a suggestion is shown
  const key = taken ? "Enter" : keyOf(action.do) || action.key;
  const shows = JSON.stringify([action, key]);
  const same = [...box.children].find((node) => node.dataset.shows === shows);
  if (same) return same;
  const node = button(`button${action.primary ? " primary" : ""}`, sentence(action.label), key, () => {
    if (settled(since.get(node))) run(action.do, action.args ?? {});
  });
  Object.assign(node.dataset, { deed: action.do, shows });
  return node;
}

/** A tablet has no keys: undo, named, and the next question are always there. */
function touchButtons(step) {
  if (!state.step) return []; // nothing is connected that could do it
  const offered = new Set(step.actions.map((action) => action.do));
  const undo = button("button", "Undo", "", () => run("undo"));
  undo.disabled = !state.list.undo;
  if (state.list.undo) undo.setAttribute("aria-label", `Undo: ${state.list.undo}`);
  const next = button("button", "Next question", "", () => run("next"));
  return [offered.has("undo") ? null : undo, offered.has("next") ? null : next].filter(Boolean);
}

/** What Enter does where nothing else takes it. */
export function primaryAction() {
  const action = stepNow().actions.find((a) => a.primary);
  if (action && settled(primaryAt)) run(action.do, action.args ?? {});
  return !!action;
}
