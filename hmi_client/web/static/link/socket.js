// The websocket: says hello, hears everything, comes back by itself. Nothing is queued while it is down.

import { header, matrixOf, posesOf, cloudOf } from "./decode.js";
import { state, put, changed, addEvent, clearList, selected } from "./store.js";
import { showImage, dropImages } from "./pictures.js";

const FIRST_WAIT_MS = 100,
  LONGEST_WAIT_MS = 800,
  BUSY_WAIT_MS = 5000,
  SILENT_MS = 3000;
const REFUSED = {
  4401: "The token is not right: open the address that hmi-client web prints.",
  4403: "This address is not allowed: open the one that hmi-client web prints.",
  4429: "Too many pages or commands: trying again.",
  4400: "hmi-client web does not understand this page: load it anew.",
};
let socket = null;
let pairBefore = null; // that was selected when the connection was lost
let wait = FIRST_WAIT_MS;

const token = () => new URLSearchParams(location.hash.slice(1)).get("token") ?? "";

/** Opens the connection and keeps it. */
export function connect() {
  const scheme = location.protocol === "https:" ? "wss" : "ws";
  const mine = (socket = new WebSocket(`${scheme}://${location.host}/ws`));
  mine.binaryType = "arraybuffer";
  mine.onopen = () => mine.send(JSON.stringify({ do: "hello", token: token(), v: 1 }));
  mine.onmessage = ({ data }) => mine === socket && hear(data);
  mine.onclose = ({ code }) => mine === socket && lost(code);
}

function lost(code) {
  state.link.open = false;
  state.link.refused = REFUSED[code] ?? "";
  pairBefore = selected() ?? pairBefore;
  dropHalf();
  changed("link");
  if (code === 4401 || code === 4403) return;
  setTimeout(connect, code === 4429 ? BUSY_WAIT_MS : wait);
  wait = Math.min(wait * 2, LONGEST_WAIT_MS);
}

/** Half a pick belongs to a connection: it must not be finished by a later click. */
function dropHalf() {
  const { assist } = clearList();
  state.list = { ...(state.told ?? state.list), half: null };
  state.told = null;
  state.assist = assist;
  changed("list", "assist");
}

/** A bridge that was started anew knows of no pair: work goes on where it was. */
function selectAgain(pair) {
  if (pair) pairBefore = null;
  if (!pairBefore?.every((name) => state.names.includes(name))) return;
  const [a, b] = pairBefore;
  if (send({ do: "select", a, b })) pairBefore = null;
}

/** Sends a command; false if nobody hears it. */
export function send(message) {
  if (!state.link.open || socket?.readyState !== WebSocket.OPEN) return false;
  socket.send(JSON.stringify(message));
  return true;
}

function hear(data) {
  state.link.heardAt = performance.now();
  if (typeof data === "string") hearText(JSON.parse(data));
  else hearBinary(data);
}

const HEARD = {
  welcome: (m) => {
    Object.assign(state.link, { open: true, refused: "" });
    wait = FIRST_WAIT_MS;
    put("welcome", m);
    changed("link");
  },
  names: (m) => {
    state.origin = m.origin;
    if (m.names.join() !== state.names.join()) forget();
    put("names", m.names);
    if (!state.list.pair) selectAgain(null);
  },
  list: (m) => {
    if (String(m.pair) !== String(state.list.pair)) {
      dropImages();
      changed("selection");
    }
    state.told = m;
    put("list", m);
    selectAgain(m.pair);
  },
  event: addEvent,
  assist: (m) => put("assist", JSON.stringify(m.hints) === state.dismissed ? { ...m, hints: [] } : m),
  health: (m) => {
    state.link.healthAt = performance.now();
    put("health", m);
    changed("link");
  },
  questions: (m) => put("questions", m.list),
  pong: (m) => {
    state.link.ping_ms = performance.now() - m.at;
    changed("link");
  },
  notice: (m) => put("notice", { ...m, at: performance.now() }),
  cursor: (m) => {
    state.cursors[m.side] = m.pixel;
    changed("cursors");
  },
};

function hearText(message) {
  const own = HEARD[message.t];
  if (own) own(message);
  else if (["step", "pair", "why", "clock"].includes(message.t)) put(message.t, message);
}

/** Indices mean other robots now. */
function forget() {
  state.clouds.clear();
  state.matrix = state.poses = null;
  changed("clouds", "matrix", "poses");
}

function hearBinary(buffer) {
  const head = header(buffer);
  if (head.kind === 1) showImage(head.side, head.n, head.id, buffer.slice(8));
  else if (head.kind === 2) put("matrix", matrixOf(buffer, head));
  else if (head.kind === 3) put("poses", posesOf(buffer, head));
  else if (head.kind === 4) {
    state.clouds.set(head.n, cloudOf(buffer, head, state.clouds.get(head.n)));
    changed("clouds");
  }
}

/** Once a second: how long a round trip takes, and whether a silent connection must be made anew. */
export function heartbeat() {
  send({ do: "ping", at: performance.now() });
  changed("tick");
  if (state.link.open && performance.now() - state.link.heardAt > SILENT_MS) socket.close();
}
