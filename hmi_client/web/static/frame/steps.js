// What the bar says: the sentences of hmi-client, and of the page itself what only the page knows:
// that a leg of the connection is broken, and that all pairs are shown at once.

import { state, broken, selected, ageText } from "../link/store.js";
import { isBad } from "../images/marks.js";
import { MOST_WORDS } from "../fleet/matrix.js";

const TONES = { ask: "act", act: "act", warn: "out", done: "good", wait: "act", gone: "warn" };

/** The step to show: {tone, kick, title, facts: [[label, text]], actions, legs}. */
export function stepNow() {
  const gone = broken();
  if (gone) return goneStep(gone);
  if (state.mode === "over") return overviewStep();
  const { step } = state;
  if (!step) return { tone: "act", kick: "", title: "Waiting for hmi-client web …", facts: [], actions: [] };
  return {
    ...step,
    tone: TONES[step.tone] ?? "act",
    kick: step.kick ?? "",
    dots: true,
    facts: (step.facts ?? []).map(fact),
    actions: [...(step.actions ?? [])].sort((a, b) => Boolean(b.primary) - Boolean(a.primary)).slice(0, 3),
  };
}

/** A fact is told as [label, text], {label, text} or "Label: text". */
function fact(told) {
  if (Array.isArray(told)) return [told[0] ?? "", told[1] ?? ""];
  if (typeof told === "object") return [told.label ?? told.title ?? "", told.text ?? ""];
  const [, label, text] = /^([^:.]{3,28}): (.+)$/s.exec(told) ?? [null, "", told];
  return [label, text];
}

/** "r3 – r8 · one of 3 questions", "3 points, 1 contradicts". */
export function kickText() {
  const names = selected();
  if (!names) return ["", ""];
  const { questions, list } = state;
  const asked = questions.some((q) => samePair([q.i, q.j], names)); // their order changes all the time
  const pair = `${names[0]} – ${names[1]}`,
    n_asked = questions.length;
  const left = !asked ? pair : `${pair} · ${n_asked > 1 ? `one of ${n_asked} questions` : "the one question"}`;
  const bad = list.points.filter(isBad).length,
    n = list.points.length;
  if (bad) return [left, `${plural(n, "point")}, ${bad} contradict${bad === 1 ? "s" : ""}`];
  return [left, list.half ? `point ${doneCount() + 1}` : n ? plural(n, "point") : ""];
}

export const doneCount = () => state.list.points.filter((p) => p.status !== "half").length;

/** A count and its noun. */
export const plural = (n, noun) => `${n} ${noun}${n === 1 ? "" : "s"}`;

const samePair = (a, b) => (a[0] === b[0] && a[1] === b[1]) || (a[0] === b[1] && a[1] === b[0]);

function goneStep({ leg, age }) {
  const kept = state.health?.kept ?? state.list.kept ?? 0;
  const clicks = kept
    ? `Your ${plural(kept, "click")} ${kept === 1 ? "is" : "are"} kept`
    : "Nothing of yours is lost";
  const never = !Number.isFinite(age);
  const old = never ? "Nothing was heard yet" : `What you see is ${ageText(age)} old · nothing to do but wait`;
  if (leg === "page") return pageGone(clicks, old, age);
  const { step } = state;
  const told = step?.tone === "gone";
  return {
    tone: never ? "act" : "warn",
    kick: old,
    title: told ? step.title : never && !kept ? "Waiting for a server" : `No server. ${clicks}`,
    legs: [null, age],
    facts: told ? step.facts.map(fact) : [],
    actions: never ? [] : [{ do: "events", label: "What was last confirmed" }],
  };
}

function pageGone(clicks, old, age) {
  const refused = state.link.refused;
  return {
    tone: "warn",
    kick: refused ? "This page is not let in" : old,
    title: refused || `No connection to hmi-client web. ${clicks}`,
    legs: [age, null],
    facts: refused
      ? []
      : [
          ["What happens now", "The page comes back by itself. Half a pick is dropped; pick it again."],
          ["If it stays away", "Is hmi-client web running?"],
        ],
    actions: [{ do: "events", label: "What was last confirmed" }],
  };
}

/** Names of robots without a place, as far as poses are known. */
export const missing = () => (state.poses ? state.names.filter((_, k) => !state.poses[k]?.located) : []);

function overviewStep() {
  const lost = missing(),
    n = state.names.length;
  const title = lost.length
    ? `${lost.length} of ${plural(n, "robot")} ${lost.length === 1 ? "is" : "are"} missing`
    : `All ${plural(n, "robot")} are located`;
  const seen =
    n > MOST_WORDS
      ? "Dark is little error, light is much, brown is hidden or rejected."
      : "The largest errors are bold. - is hidden or rejected, ~ known through others, · never tried.";
  const facts = [["What you see", seen]];
  if (state.step) facts.push(["What to do", state.step.title]);
  if (lost.length)
    facts.unshift(["Missing", `${listed(lost)} ${lost.length === 1 ? "is" : "are"} not joined.`]);
  const next = state.questions.length ? [{ do: "next", label: "First question", primary: true }] : [];
  return {
    tone: "act",
    kick: "Overview of all pairs",
    title,
    facts,
    actions: [...next, { do: "overview", label: "Back" }],
  };
}

/** "r41, r42 and r43", at most six by name. */
export function listed(names, most = 6) {
  const shown = names.slice(0, most),
    rest = names.length - shown.length;
  if (rest) return `${shown.join(", ")} and ${rest} more`;
  return shown.length > 1 ? `${shown.slice(0, -1).join(", ")} and ${shown.at(-1)}` : (shown[0] ?? "");
}
