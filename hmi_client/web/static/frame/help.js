// The pages over the page: keys and signs, what happened, and why a robot is located or not.

import { el, onPress } from "./dom.js";
import { state, watch } from "../link/store.js";
import { command } from "../link/commands.js";
import { entries, keysOf, printed } from "./keys.js";
import { clockText } from "./frame.js";

const help = document.getElementById("help"),
  log = document.getElementById("log");
const SIGNS = [
  ["1", "a clicked point"],
  ["1!", "contradicts the others"],
  ["◇ ···", "where it is expected: a guess"],
  ["-", "above the threshold, or rejected"],
  ["~", "known only through others"],
  ["·", "never tried"],
  ["•", "points were clicked here"],
  ["?", "not proven"],
];
const PAGE = [
  ["arrows", "one pixel, with Shift ten"],
  ["H", "hides all marks while held"],
  ["Enter", "what the bar's first button does"],
  ["Wheel", "nearer, farther"],
  ["Shift-click", "to the nearest corner"],
];

/** Registers the pages and their keys. */
export function startHelp() {
  command("help", () => toggle(help, drawHelp));
  command("events", () => toggle(log, drawLog));
  onPress(document.getElementById("help-button"), () => toggle(help, drawHelp));
  for (const dialog of [help, log])
    dialog.addEventListener("click", (e) => {
      if (e.target === dialog) dialog.close();
    });
  document.addEventListener(
    "keydown",
    (e) => {
      if (help.open && e.key === "?") {
        help.close();
        e.preventDefault();
        e.stopImmediatePropagation();
      }
    },
    true,
  );
  watch(["why"], () => {
    if (state.why) open(log, drawWhy);
  });
}

function toggle(dialog, draw) {
  if (dialog.open) dialog.close();
  else open(dialog, draw);
}

function open(dialog, draw) {
  draw();
  if (!dialog.open) dialog.showModal();
}

const head = (text, dialog) => {
  const close = el("button", "close", el("kbd", "", "Esc"), " goes back");
  return el("div", "head", el("h2", "", text), onPress(close, () => dialog.close()));
};

function row(keys, text) {
  return el(
    "div",
    "key",
    el("span", "", ...keys.flatMap((key) => [el("kbd", "", key), " "])),
    el("span", "", text),
  );
}

function drawHelp() {
  const places = grouped(entries());
  const groups = [...places].map(([place, all]) =>
    el("section", "", el("h3", "", title(place)), ...all.map((e) => row(keysOf(e).map(printed), e.does))),
  );
  groups.push(el("section", "", el("h3", "", "This page"), ...PAGE.map(([key, text]) => row([key], text))));
  groups.push(el("section", "", el("h3", "", "Signs"), ...SIGNS.map(([sign, text]) => row([sign], text))));
  help.replaceChildren(head("Keys and signs", help), el("div", "columns", ...groups));
}

function grouped(list) {
  const groups = new Map();
  for (const entry of list) groups.set(entry.place, [...(groups.get(entry.place) ?? []), entry]);
  return groups;
}

const title = (place) => String(place).replace(/^./, (c) => c.toUpperCase());

function drawLog() {
  const items = state.events.map((event) =>
    el("li", event.tone ?? "", el("time", "", clockText(event.at_ms)), el("span", "", event.text)),
  );
  log.replaceChildren(
    head("What happened", log),
    items.length ? el("ol", "", ...items) : el("p", "dim", "Nothing yet."),
  );
}

function drawWhy() {
  const { robot, lines } = state.why;
  log.replaceChildren(
    head(robot ? `Why ${robot} is where it is` : "Why", log),
    el("ul", "why", ...lines.map((line) => el("li", "", line))),
  );
}
