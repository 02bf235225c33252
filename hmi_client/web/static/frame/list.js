// The list of points, of which only the visible rows exist; the verdict above it; and, where no pair
// is selected, the questions.

import { el, button, onPress, say } from "./dom.js";
import { state, watch, changed, selected, markerColour, lengthText, nameOf, broken } from "../link/store.js";
import { isBad } from "../images/marks.js";
import { run } from "../link/commands.js";
import { keyOf } from "./keys.js";
import { toPoint } from "../images/cursors.js";
import { plural } from "./steps.js";

const panel = document.getElementById("pair");
const [title, count, verdict, rows] = ["h2 .title", ".count", ".verdict", ".rows"].map((s) =>
  panel.querySelector(s),
);
const SPARE = 4; // rows beyond each end of what is visible
const touch = matchMedia("(max-width: 1240px)");
const sight = { top: 0, height: 0 }; // of the rows: asking the page for it lays all of it out
let byResidual = false,
  shown = "";

/** Draws the panel on each change, its rows also on scrolling. */
export function startList() {
  watch(["pair"], () => panel.classList.contains("questions") || drawVerdict());
  watch(["list", "questions", "assist", "names", "mode", "link", "welcome", "why"], draw);
  const look = () => {
    Object.assign(sight, { top: rows.scrollTop, height: rows.clientHeight });
    drawRows();
  };
  rows.addEventListener("scroll", look, { passive: true });
  new ResizeObserver(look).observe(rows);
}

function draw() {
  const names = selected();
  const questions = !names || state.mode === "over";
  panel.classList.toggle("questions", questions);
  say(
    title,
    questions
      ? state.mode === "over"
        ? "Questions, the most useful first"
        : "No pair is selected"
      : `${names[0]} – ${names[1]}`,
  );
  title.classList.toggle("red", !questions);
  say(
    count,
    questions ? (state.mode === "over" ? "gain per click" : "") : plural(state.list.points.length, "point"),
  );
  if (questions) drawQuestions();
  else {
    drawVerdict();
    drawRows();
  }
}

function drawVerdict() {
  const told = state.pair,
    names = selected();
  const same = told && [told.i, told.j].map(nameOf).every((name, k) => name === names[k]);
  const chip = same && told.verdict ? el("span", `chip ${told.verdict}`, told.verdict) : null;
  const numbers = same
    ? [
        told.sigma_cm != null ? `known to ${lengthText(told.sigma_cm / 100)}` : "",
        told.overlap != null ? `overlap ${Math.round(100 * told.overlap)} %` : "",
      ]
        .filter(Boolean)
        .join(" · ")
    : "";
  const others = (state.list.others ?? []).map(nameOf);
  const lines = [
    numbers,
    state.list.words === told?.sentence ? "" : state.list.words,
    others.length ? `${others.join(" and ")} ${others.length === 1 ? "is" : "are"} here too` : "",
  ].filter(Boolean);
  verdict.replaceChildren(
    el("div", "head", chip, el("span", "", same ? withoutVerdict(told) : "")),
    el("ul", "", ...lines.map((line) => el("li", "", line))),
  );
}

/** The chip says the verdict already. */
const withoutVerdict = ({ sentence, verdict }) =>
  verdict && sentence?.startsWith(`${verdict}, `) ? sentence.slice(verdict.length + 2) : (sentence ?? "");

function drawQuestions() {
  verdict.replaceChildren(
    state.mode === "over"
      ? ""
      : el(
          "p",
          "dim",
          state.questions.length
            ? "These pairs would help most:"
            : state.names.length > 1
              ? "Nothing is asked. Select any cell of the matrix to look at two images."
              : "Questions come once two robots are here.",
        ),
  );
  shown = "";
  rows.replaceChildren(...state.questions.map((q, k) => questionRow(q, k)));
}

function questionRow(q, k) {
  const names = selected() ?? [];
  const here = names.includes(nameOf(q.i)) && names.includes(nameOf(q.j));
  const row = el(
    "button",
    `question${here ? " current" : ""}`,
    el("span", "dim", `${k + 1}`),
    el("b", "", `${nameOf(q.i)} – ${nameOf(q.j)}`),
    el("span", "dim", q.why ?? ""),
    el("b", "number", q.gain ? (q.gain < 0.001 ? "< 0.1 cm" : lengthText(q.gain)) : ""),
  );
  return onPress(row, () => {
    if (state.mode === "over") run("overview");
    run("select", { a: nameOf(q.i), b: nameOf(q.j) });
  });
}

const rowHeight = () => (touch.matches ? 48 : 36);
const moreHeight = () => (touch.matches ? 56 : 40);

function sorted() {
  const points = [...state.list.points];
  return byResidual ? points.sort((a, b) => (b.residual_m ?? -1) - (a.residual_m ?? -1)) : points;
}

function drawRows() {
  if (!selected() || state.mode === "over") return;
  const points = sorted(),
    h = rowHeight();
  const open = points.findIndex((p) => p.id === (state.assist.wrong?.id ?? state.current));
  const extra = (k) => (open >= 0 && k > open ? moreHeight() : 0);
  const first = Math.max(0, Math.floor((sight.top - moreHeight()) / h) - SPARE),
    last = Math.min(points.length, Math.ceil((sight.top + sight.height) / h) + SPARE);
  const seen = points.slice(first, last);
  const all = [seen, points.length, first, open, h, state.assist.wrong, !!broken(), selected(), byResidual];
  const told = JSON.stringify(all);
  if (told === shown) return; // rows stay under the hand until they say something else
  shown = told;
  const space = el("div", "space");
  space.style.height = `${points.length * h + (open >= 0 ? moreHeight() : 0)}px`;
  seen.forEach((point, k) => {
    const row = pointRow(point, first + k === open);
    row.style.top = `${(first + k) * h + extra(first + k)}px`;
    space.append(row);
  });
  const focused = rows.contains(document.activeElement)
    ? document.activeElement.closest(".row")?.dataset.id
    : null;
  rows.replaceChildren(heading(), space);
  if (focused)
    space.querySelector(`[data-id="${CSS.escape(focused)}"] .fields`)?.focus({ preventScroll: true });
}

function heading() {
  const sort = button("sort", byResidual ? "off by ▾" : "off by", "", () => {
    byResidual = !byResidual;
    drawRows();
  });
  sort.setAttribute("aria-label", byResidual ? "Sorted by error; sort by number" : "Sort by error");
  return el("div", "heads", el("span"), el("span", "", "your points"), sort, el("span", "pixels", "by"));
}

const SAYS = {
  half: "half: missing in the other image",
  pending: "sent, not confirmed yet",
  confirmed: "fits",
  unused: "not used",
  outlier: "does not fit the others",
  rejected: "refused",
};

function words(point) {
  return point.other_view ? `${stateOf(point).replace(" the others", "")} · other view` : stateOf(point);
}

function stateOf(point) {
  if (point.status === "half") return `half: missing in ${selected()[point.pi ? 1 : 0]}`;
  if (point.status === "pending" && broken()) return "kept here";
  if (point.reason && point.status !== "confirmed")
    return point.status === "outlier" ? SAYS.outlier : `${SAYS[point.status]}: ${point.reason}`;
  return SAYS[point.status] ?? point.status;
}

function pointRow(point, open) {
  const bad = isBad(point);
  const pill = el("span", "pill", `${point.n}${bad ? "!" : ""}`);
  pill.style.background = bad ? "var(--out-mark)" : markerColour(point.n);
  const fields = el(
    "button",
    "fields",
    pill,
    el("span", `say ${point.status}`, el("span", "words", words(point)), share(point)),
    el("span", "number", lengthText(point.residual_m)),
    el("span", "pixels", point.by ?? ""),
  );
  onPress(fields, () => {
    toPoint(point.id);
    state.current = point.id;
    changed("list");
  });
  const row = el(
    "div",
    `row${bad ? " bad" : ""}${point.status === "half" || open ? " current" : ""}`,
    fields,
    open && point.id !== null ? deeds(point) : null,
  );
  row.dataset.id = point.id;
  row.title = point.reason ?? "";
  return row;
}

/** The error as a bar: full at 20 cm. */
function share(point) {
  if (point.residual_m === null || point.residual_m === undefined) return null;
  const fill = el("i");
  fill.style.width = `${Math.min(98, (100 * point.residual_m) / 0.2)}%`;
  return el("span", "share", fill);
}

function deeds(point) {
  const { wrong } = state.assist;
  const move =
    wrong?.id === point.id && wrong.fits
      ? button("small primary", "Move to ◇", keyOf("move"), () =>
          run("move", { id: point.id, side: wrong.side, pixel: wrong.fits }),
        )
      : null;
  const erase = button("small", "Erase", keyOf("erase"), () => run("erase", { id: point.id }));
  const show = button("small", "Show", keyOf("show"), () => run("show", { id: point.id }));
  return el("div", "deeds", move, erase, show);
}
