// All that the page knows, and who draws what of it. What a hand does is drawn at once, and what comes
// of it in the next frame; what else comes is gathered, so that both images make one frame.

const GATHER_MS = 80, // longer than the bridge waits between two looks: a pair of images is one frame
  HAND_MS = 1000; // after what a hand did
const NO_LIST = {
  pair: null,
  points: [],
  half: null,
  frozen: false,
  kept: 0,
  confirmed: 0,
  others: [],
  undo: null,
  redo: null,
  words: "",
};
const NO_ASSIST = { side: 0, expected: null, suggestion: null, hints: [], wrong: null };
const MOST_EVENTS = 200;

export const state = {
  welcome: null,
  names: [],
  origin: null,
  step: null,
  list: NO_LIST, // with clicks that the bridge has not answered yet
  told: null, // as the bridge told it
  assist: NO_ASSIST,
  pair: null,
  questions: [],
  events: [],
  notice: null,
  why: null,
  health: null,
  clock: null,
  matrix: null,
  poses: null,
  clouds: new Map(),
  images: [null, null],
  cursors: [null, null],
  active: 0,
  current: null,
  mode: "pick",
  theme: "dark",
  panel: "map",
  marksHidden: false,
  typed: "",
  dismissed: "",
  link: { open: false, refused: "", heardAt: performance.now(), healthAt: performance.now(), ping_ms: null },
};

const watchers = new Map();
const reactions = new Map();
const dirty = new Set();
let frame = 0,
  timer = 0,
  handAt = -HAND_MS,
  awaited = [];

/** Calls `draw` in one of the next frames after one of the topics changed. */
export function watch(topics, draw) {
  for (const topic of topics) watchers.set(topic, [...(watchers.get(topic) ?? []), draw]);
}

/** Calls `deed` at once when one of the topics changed, before anything else can happen. */
export function react(topics, deed) {
  for (const topic of topics) reactions.set(topic, deed);
}

/** Says that topics changed. */
export function changed(...topics) {
  for (const deed of new Set(topics.map((topic) => reactions.get(topic)))) deed?.();
  for (const topic of topics) for (const draw of watchers.get(topic) ?? []) dirty.add(draw);
  if (dirty.size && !frame) drawSoon();
}

/** Calls `deed` once all that changed until now is on the screen. */
export function drawn(deed) {
  awaited.push(deed);
  if (!frame) drawSoon();
}

function drawSoon() {
  const inFrame = () => (frame ||= requestAnimationFrame(flush));
  if (performance.now() - handAt < HAND_MS) inFrame();
  else timer ||= setTimeout(inFrame, GATHER_MS);
}

function flush() {
  cancelAnimationFrame(frame);
  clearTimeout(timer);
  frame = timer = 0;
  const draws = [...dirty];
  dirty.clear();
  for (const draw of draws) draw();
  const deeds = awaited;
  awaited = [];
  if (deeds.length) requestAnimationFrame(() => deeds.forEach((deed) => deed()));
}

const noteHand = () => (handAt = performance.now());
for (const hand of ["pointerdown", "pointermove", "wheel"]) addEventListener(hand, noteHand, true);
for (const hand of ["keydown", "pointerup", "click"]) {
  addEventListener(hand, noteHand, true);
  addEventListener(hand, flush);
}

/** Puts a value and says so. */
export function put(topic, value) {
  state[topic] = value;
  changed(topic);
}

/** Whether a click was drawn of which the bridge has not told yet what came of it. */
export const unanswered = () => state.told !== null && state.list !== state.told;

export const clearList = () => ({ list: NO_LIST, assist: NO_ASSIST });

/** A robot's name, be it told by name or by index. */
export const nameOf = (robot) => (typeof robot === "number" ? (state.names[robot] ?? "") : (robot ?? ""));

/** Names of the selected pair, or null. */
export const selected = () => (state.list.pair ? state.list.pair.map(nameOf) : null);

export const markerColour = (n) => {
  const { markers } = state.welcome.colours; // nothing is marked before it has come
  return markers[(Math.max(1, n) - 1) % markers.length];
};

/** The newest event first; only so many are held. */
export function addEvent(event) {
  state.events.unshift(event);
  state.events.length = Math.min(state.events.length, MOST_EVENTS);
  changed("events");
}

/** What is broken, or null: the leg, since how many seconds; infinitely many if it was never whole. */
export function broken() {
  const { link, health } = state;
  const silent = (performance.now() - link.heardAt) / 1000;
  if (!link.open || silent > 3) return { leg: "page", age: (health ? health.age_s || 0 : 0) + silent };
  if (health?.server !== "gone") return null;
  return { leg: "server", age: (health.age_s ?? Infinity) + (performance.now() - link.healthAt) / 1000 };
}

export const ageText = (seconds) =>
  Number.isFinite(seconds) ? `${Math.max(1, Math.round(seconds))} s` : "a while";
export const lengthText = (m) => {
  if (m === null || m === undefined || !Number.isFinite(m)) return "–";
  if (m >= 10) return `${m.toFixed(0)} m`;
  if (m >= 1) return `${m.toFixed(1)} m`;
  return `${(100 * m).toFixed(1)} cm`;
};
