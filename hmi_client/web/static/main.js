// The operator's page: all parts are put together here.

import { state, watch } from "./link/store.js";
import { connect, heartbeat } from "./link/socket.js";
import { command, sendAs } from "./link/commands.js";
import { startKeys } from "./frame/keys.js";
import { startBar } from "./frame/bar.js";
import { startCursors } from "./images/cursors.js";
import { startList } from "./frame/list.js";
import { startFrame } from "./frame/frame.js";
import { startHelp } from "./frame/help.js";
import { startLayout } from "./frame/layout.js";
import { startMap } from "./fleet/map.js";
import { startMatrix } from "./fleet/matrix.js";
import { startScene } from "./fleet/scene.js";
import { ImagePanel } from "./images/images.js";

const panels = [new ImagePanel(0), new ImagePanel(1)];
document.getElementById("images").append(...panels.map((panel) => panel.section));
const middle = (panel) => [panel.surface.width / 2, panel.surface.height / 2];
const zoom = (factor) => {
  const panel = panels[state.active];
  panel.zoomBy(
    factor,
    state.cursors[state.active] && state.images[state.active]
      ? panel.toScreen(state.cursors[state.active])
      : middle(panel),
  );
};
command("zoom-in", () => zoom(1.5));
command("zoom-out", () => zoom(1 / 1.5));
command("go", (args) => {
  const panel = panels[args.side ?? state.active];
  sendAs("go", state.images[panel.side] ? { ...panel.inSight(), ...args } : args);
});
command("fit", () => panels[state.active].fit());

const map = startMap(),
  matrix = startMatrix();
startScene();
startLayout();
startBar();
startList();
startFrame();
startHelp();
const reveal = () => panels.forEach((panel) => panel.reveal());
startCursors(reveal);
startKeys({ reveal, map: map.pan, matrix: matrix.step });
watch(["list"], () => {
  document.title = state.list.pair ? `${state.list.pair.join(" – ")} · fleetpose` : "fleetpose";
});

connect();
setInterval(heartbeat, 1000);
