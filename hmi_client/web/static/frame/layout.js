// Which panels are shown, in which theme; what is seen is told to the bridge, which sends nothing else.

import { el, onPress, say } from "./dom.js";
import { state, watch, put, changed, selected } from "../link/store.js";
import { command, run } from "../link/commands.js";
import { send } from "../link/socket.js";
import { activate } from "../images/cursors.js";

const main = document.getElementById("main");
const images = document.getElementById("images"),
  left = main.querySelector(".left"),
  middle = main.querySelector(".middle");
const scene = document.getElementById("scene"),
  events = document.getElementById("events");
const small = matchMedia("(max-width: 1240px)");
const TABS = [
  ["map", "Map"],
  ["matrix", "Matrix"],
  ["pair", "Points"],
  ["scene", "3D"],
];
const PANELS = {
  "panel-map": "#map",
  "panel-matrix": "#matrix [tabindex='0']",
  "panel-list": "#pair button",
  "panel-left": "[data-panel=left]",
  "panel-right": "[data-panel=right]",
};
const SIDES = { "panel-left": 0, "panel-right": 1 };
let wanted = "",
  saved = "";

/** Registers the commands of the layout and follows the state. */
export function startLayout() {
  command("maximise", () => put("mode", state.mode === "max" ? "pick" : "max"));
  command("overview", () => put("mode", state.mode === "over" ? "pick" : "over"));
  command("redraw", () => changed("theme", "matrix", "list"));
  command("quit", () => window.close());
  for (const [id, where] of Object.entries(PANELS))
    command(id, () => {
      show(id.slice(6));
      document.querySelector(where)?.focus();
      if (id in SIDES) activate(SIDES[id]); // it may have had the focus before
    });
  onPress(document.getElementById("theme"), () => setTheme(state.theme === "dark" ? "light" : "dark"));
  for (const node of document.querySelectorAll("[data-do]")) onPress(node, () => run(node.dataset.do));
  document.getElementById("tabs").append(...TABS.map(tab));
  watch(["welcome"], restore);
  watch(["mode", "selection", "panel", "welcome", "images"], arrange);
  watch(["list"], countBad);
  small.addEventListener("change", arrange);
  document.addEventListener("visibilitychange", want);
  arrange();
}

function tab([id, label]) {
  const node = el("button", "", label, el("span", "badge"));
  node.setAttribute("role", "tab");
  node.dataset.tab = id;
  return onPress(node, () => put("panel", id));
}

const show = (name) => {
  const id = { list: "pair", map: "map", matrix: "matrix" }[name];
  if (id) put("panel", id);
};

function restore() {
  const { theme, panel } = state.welcome.settings ?? {};
  saved = JSON.stringify({ theme: theme ?? state.theme, panel: panel ?? state.panel });
  if (theme) setTheme(theme);
  if (panel) put("panel", panel);
  wanted = "";
  want();
}

function setTheme(theme) {
  document.documentElement.dataset.theme = theme === "light" ? "light" : "dark";
  put("theme", document.documentElement.dataset.theme);
  save();
}

/** Kept by hmi-client, as the page's address may change. */
function save() {
  const settings = { theme: state.theme, panel: state.panel };
  if (JSON.stringify(settings) === saved || !state.welcome) return;
  if (send({ do: "settings", set: settings })) saved = JSON.stringify(settings);
}

function arrange() {
  const idle = !selected() && state.mode !== "max";
  const mode = state.mode === "pick" && idle ? "idle" : state.mode;
  main.className = `${mode}${main.classList.contains("stale") ? " stale" : ""}`;
  const big = mode === "idle";
  place(scene, big ? main : left);
  place(
    events,
    mode === "idle" && !small.matches ? left : mode === "over" ? document.getElementById("pair") : middle,
  );
  for (const node of document.querySelectorAll("[data-tab]"))
    node.setAttribute("aria-selected", String(node.dataset.tab === state.panel));
  for (const id of ["map", "matrix", "pair", "scene"])
    document.getElementById(id).classList.toggle("on", id === (big && state.panel === "scene" ? "map" : state.panel));
  for (const id of ["matrix", "pair"])
    place(
      document.getElementById(id),
      small.matches && mode !== "over" ? left : middle,
      id === "matrix" ? middle.firstElementChild : mode !== "over" && mode !== "idle" ? events : null,
    );
  save();
  want();
}

function countBad() {
  const bad = state.list.points.filter((p) => p.status === "outlier" || p.status === "rejected").length;
  say(document.querySelector("[data-tab=pair] .badge"), bad ? `${bad}` : "");
}

/** Moves a panel only where it is not there yet, so that it keeps focus and scroll. */
function place(node, parent, before = null) {
  if (node.parentElement === parent) return;
  parent.insertBefore(node, before?.parentElement === parent ? before : null);
}

/** Nothing unseen is sent. */
function want() {
  const seen = (node) => !document.hidden && node.offsetParent !== null;
  const message = {
    do: "want",
    images: seen(images),
    clouds: seen(scene),
    matrix: seen(document.getElementById("matrix")) || seen(document.getElementById("map")),
  };
  if (JSON.stringify(message) !== wanted && send(message)) wanted = JSON.stringify(message);
}
