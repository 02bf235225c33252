// Head and foot of the page: how the fleet is, who is here, the connection; what happened last, keys
// worth knowing, and what the server confirmed. And the clock of a recording.

import { el, button, onPress, say } from "./dom.js";
import { state, watch, broken, nameOf, selected, ageText } from "../link/store.js";
import { missing, listed, plural } from "./steps.js";
import { keyOf } from "./keys.js";
import { run } from "../link/commands.js";
import { send } from "../link/socket.js";

const byId = (id) => document.getElementById(id);
const foot = document.querySelector("footer");
const MOST_FOOT = 55; // letters of an event beside the keys, at 1600 px
const NOTICE_MS = 8000;
const HINTS = [
  ["next", "next question"],
  ["accept", "suggestion"],
  ["maximise", "images only"],
  ["overview", "overview"],
  ["undo", "take back"],
  ["help", "all keys"],
];

/** Draws on every change and once a second. */
export function startFrame() {
  watch(["health", "poses", "names", "list", "link", "tick", "welcome"], drawHead);
  watch(["events", "notice", "health", "list", "welcome", "tick", "link", "assist"], drawFoot);
  watch(["events", "link", "tick"], drawEvents);
  watch(["clock"], drawClock);
}

export const clockText = (ms) => new Date(ms).toTimeString().slice(0, 8);

function drawHead() {
  const { health, names, welcome, list } = state;
  const n = health?.robots ?? names.length,
    located = health?.located ?? names.length - missing().length;
  const lost = missing();
  const parts = n ? [el("span", "good", `● ${located} of ${n} located`)] : [];
  if (lost.length) parts.push(el("span", "apart", `◌ ${listed(lost, 4)} not joined`));
  fill("summary", parts);
  say(byId("site"), welcome?.site ? `site ${welcome.site}${welcome.replay ? ", a recording" : ""}` : "");
  const others = (list.others ?? []).map(nameOf);
  const pair = selected();
  const at = (names) => (names ? ` at ${names[0]} – ${names[1]}` : "");
  const here = [
    ...others.map((name) => person(name, at(pair))),
    ...Object.entries(list.elsewhere ?? {}).map(([name, names]) => person(name, at(names))),
  ];
  fill("who", [...here, ...(welcome ? [person(`you: ${welcome.operator}`, "", welcome.operator)] : [])]);
  drawLink();
}

const person = (text, at, name = text) => el("span", "person", el("i", "", name.slice(0, 1)), `${text}${at}`);

/** Replaces children only where their words changed. */
function fill(id, children) {
  const node = byId(id),
    now = children.map((c) => c.textContent).join("|");
  if (node.dataset.words === now) return;
  node.dataset.words = now;
  node.replaceChildren(...children);
}

function drawLink() {
  const gone = broken(),
    { health } = state,
    node = byId("link");
  const slow = health?.server === "slow";
  node.classList.toggle("bad", !!gone || slow);
  const ok = health
    ? `${slow ? "Slow" : "Live"} · server ${(health.age_s ?? 0).toFixed(1)} s`
    : "Connecting …";
  say(
    node.querySelector("span"),
    gone
      ? gone.leg === "page"
        ? `No connection, ${ageText(gone.age)}`
        : Number.isFinite(gone.age)
          ? `No server, ${ageText(gone.age)}`
          : "No server yet"
      : ok,
  );
  byId("main").classList.toggle("stale", !!gone && Number.isFinite(gone.age));
  for (const stamp of document.querySelectorAll(".stamp")) say(stamp, gone && Number.isFinite(gone.age) ? `${ageText(gone.age)} old` : "");
}

/** As many clauses as the foot has room for; all of it stands under "What happened". */
function begun(text) {
  const clauses = text.split(/(?=[;:,] )/);
  while (clauses.length > 1 && clauses.join("").length > MOST_FOOT) clauses.pop();
  return clauses.join("");
}

function drawFoot() {
  const event = state.events[0],
    notice = state.notice;
  say(foot.querySelector(".event"), event ? `${clockText(event.at_ms)}  ${begun(event.text)}` : "");
  say(byId("notice"), notice && performance.now() - notice.at < NOTICE_MS ? notice.text : "");
  const keys = HINTS.map(([id, label]) => [keyOf(id), label, id]).filter(([key]) => key);
  const words = keys.flat().join("|") + state.list.undo;
  const box = foot.querySelector(".keys");
  if (box.dataset.words !== words) {
    box.dataset.words = words;
    box.replaceChildren(
      ...keys.map(([key, label, id]) =>
        keyButton(key, id === "undo" && state.list.undo ? `take back: ${state.list.undo}` : label, id),
      ),
    );
  }
  drawKept();
}

/** What a key does, for those who have a mouse in the hand. */
function keyButton(key, label, id) {
  const node = el("button", "hint", el("kbd", "", key), ` ${label}`);
  node.tabIndex = -1; // the keys are there already
  return onPress(node, () => {
    run(id);
    node.blur();
  });
}

function drawKept() {
  const { health, list } = state,
    node = foot.querySelector(".kept");
  const waiting = health?.unconfirmed ?? 0,
    confirmed = health?.confirmed ?? list.confirmed;
  node.classList.toggle("wait", waiting > 0);
  say(
    node,
    waiting
      ? `◔ ${plural(waiting, "click")} not confirmed yet`
      : confirmed
        ? `✓ all ${plural(confirmed, "click")} confirmed`
        : "nothing sent yet",
  );
}

function drawEvents() {
  const items = state.events
    .slice(0, 30)
    .map((event) =>
      el("li", event.tone ?? "", el("time", "", clockText(event.at_ms)), el("span", "", event.text)),
    );
  const list = document.querySelector("#events ol");
  if (list.dataset.first === String(items.length) + state.events[0]?.text) return;
  list.dataset.first = String(items.length) + state.events[0]?.text;
  list.replaceChildren(...items);
}

function drawClock() {
  const { clock } = state,
    box = byId("clock");
  box.hidden = !clock;
  if (!clock) return;
  if (!box.firstChild) buildClock(box);
  const [play, seek, speed, text] = box.children;
  say(play, clock.paused ? "Play" : "Pause");
  if (document.activeElement !== seek) {
    seek.max = clock.of_s;
    seek.value = clock.s;
  }
  if (document.activeElement !== speed) speed.value = String(clock.speed);
  say(text, `${clock.s.toFixed(1)} of ${clock.of_s.toFixed(1)} s`);
}

function buildClock(box) {
  const seek = el("input", "seek"),
    speed = el(
      "select",
      "speed",
      ...[0.25, 0.5, 1, 2, 4, 8].map((x) =>
        Object.assign(el("option", "", `${x}×`), { value: x, selected: x === 1 }),
      ),
    );
  Object.assign(seek, { type: "range", min: 0, step: 0.1 });
  seek.setAttribute("aria-label", "Time of the recording");
  speed.setAttribute("aria-label", "Speed");
  seek.addEventListener("change", () => {
    send({ do: "seek", s: Number(seek.value) });
    seek.blur();
  });
  speed.addEventListener("change", () => {
    send({ do: "speed", value: Number(speed.value) });
    speed.blur();
  });
  box.append(
    button("button", "Play", "", () => send({ do: "play", paused: !state.clock.paused })),
    seek,
    speed,
    el("span", "dim"),
  );
}
