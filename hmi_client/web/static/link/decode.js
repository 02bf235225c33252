// Binary frames of the bridge: 8 bytes (kind, side, n, id), then the numbers as they are in memory.

/** float16 to number. */
export function half(bits) {
  const sign = bits & 0x8000 ? -1 : 1;
  const exponent = (bits >> 10) & 31,
    fraction = bits & 1023;
  if (exponent === 31) return fraction ? NaN : sign * Infinity;
  return sign * (exponent ? 2 ** (exponent - 15) * (1 + fraction / 1024) : 2 ** -14 * (fraction / 1024));
}

/** The header of a frame. */
export function header(buffer) {
  const view = new DataView(buffer);
  return {
    kind: view.getUint8(0),
    side: view.getUint8(1),
    n: view.getUint16(2, true),
    id: view.getUint32(4, true),
  };
}

const STATES = ["unknown", "known", "tried", "unknown"];
const VERDICTS = ["", "verified", "plausible", "ambiguous", "rejected"];

/** Errors and states of all pairs; `at(a, b)` by indices in either order, `links` those with a pose. */
export function matrixOf(buffer, { n, id }) {
  const pairs = (n * (n - 1)) / 2;
  const raw = new Uint16Array(buffer, 8, pairs),
    states = new Uint8Array(buffer, 8 + 2 * pairs, pairs);
  const values = Float32Array.from(raw, half);
  const place = (a, b) => (a < b ? a * n - (a * (a + 1)) / 2 + b - a - 1 : place(b, a));
  return {
    n,
    quantity: id,
    values,
    states,
    links: linksOf(n, states),
    at: (a, b) => cellOf(values[place(a, b)], states[place(a, b)]),
    place,
  };
}

/** Pairs that were tried and not rejected: {a, b, verdict}. */
function linksOf(n, states) {
  const links = [];
  let k = 0;
  for (let a = 0; a < n; a++)
    for (let b = a + 1; b < n; b++, k++) {
      const verdict = (states[k] & 3) === 2 ? VERDICTS[(states[k] >> 2) & 7] : "";
      if (verdict && verdict !== "rejected") links.push({ a, b, verdict });
    }
  return links;
}

/** What the bits of a pair's state say. */
export const cellOf = (value, bits) => ({
  value,
  state: STATES[bits & 3],
  verdict: VERDICTS[(bits >> 2) & 7] ?? "",
  clicked: !!(bits & 32),
  asked: !!(bits & 64),
  hidden: !!(bits & 128),
});

/** Positions, headings and covariances of all robots. */
export function posesOf(buffer, { n }) {
  const f = new Float32Array(buffer, 8, 8 * n);
  return Array.from({ length: n }, (_, k) => {
    const [x, y, heading, xx, xy, yy, located, component] = f.subarray(8 * k, 8 * k + 8);
    return { x, y, heading, xx, xy, yy, located: located > 0.5, component };
  });
}

/** A robot's cloud in the fleet's frame; without points of its own it keeps those of `old`. */
export function cloudOf(buffer, { id }, old) {
  const pose = new Float32Array(buffer, 8, 12),
    quantum = new DataView(buffer).getFloat32(56, true);
  const count = Math.floor((buffer.byteLength - 60) / 9);
  const points = count ? new Int16Array(buffer, 60, 3 * count) : (old?.points ?? new Int16Array(0));
  const colours = count
    ? new Uint8Array(buffer, 60 + 6 * count, 3 * count)
    : (old?.colours ?? new Uint8Array(0));
  const step = count ? quantum : (old?.step ?? quantum);
  return { id, pose: Array.from(pose), points, colours, step, fleet: placed(points, step, pose) };
}

function placed(points, step, T) {
  const out = new Float32Array(points.length);
  for (let k = 0; k < points.length; k += 3) {
    const x = points[k] * step,
      y = points[k + 1] * step,
      z = points[k + 2] * step;
    for (let row = 0; row < 3; row++) {
      out[k + row] = T[4 * row] * x + T[4 * row + 1] * y + T[4 * row + 2] * z + T[4 * row + 3];
    }
  }
  return out;
}
