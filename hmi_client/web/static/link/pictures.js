// The newest image of each side. One is decoded at a time, the one before is closed, and the bridge
// hears of each that was drawn, so that the next may come.

import { state, changed, drawn, unanswered } from "./store.js";
import { send } from "./socket.js";

const waiting = [null, null];
const busy = [false, false];
let pair = 0; // counts pairs: what was decoded for an earlier one is not shown

/** Decodes a JPEG and shows it, unless a newer one came meanwhile. While a click is not answered, what
 * comes was sent before the bridge held the images, and is not shown.
 */
export async function showImage(side, scale, view, jpeg) {
  if (unanswered() && state.images[side]) return void send({ do: "ack", side, view });
  waiting[side] = { scale, view, jpeg };
  if (busy[side]) return;
  busy[side] = true;
  while (waiting[side]) {
    const next = waiting[side];
    waiting[side] = null;
    await decode(side, next);
  }
  busy[side] = false;
}

async function decode(side, { scale, view, jpeg }) {
  const mine = pair;
  const bitmap = await createImageBitmap(new Blob([jpeg], { type: "image/jpeg" })).catch(() => null);
  if (bitmap && mine !== pair) bitmap.close();
  else if (bitmap)
    take(side, { bitmap, scale, view, width: bitmap.width * scale, height: bitmap.height * scale });
  else drawn(() => send({ do: "ack", side, view })); // a damaged one must not stop the next
}

function take(side, image) {
  const before = state.images[side];
  before?.bitmap.close();
  state.images[side] = image;
  const { half } = state.list;
  state.cursors[side] ??= half?.side === side ? half.pixel : [(image.width - 1) / 2, (image.height - 1) / 2];
  if (before?.width === image.width && before.height === image.height) changed(`image ${side}`);
  else changed("images");
  drawn(() => send({ do: "ack", side, view: image.view }));
}

/** Another pair has other images: the old ones are not its own. */
export function dropImages() {
  pair += 1;
  for (const side of [0, 1]) {
    state.images[side]?.bitmap.close();
    state.images[side] = waiting[side] = null;
    state.cursors[side] = null;
  }
  changed("images", "cursors");
}
