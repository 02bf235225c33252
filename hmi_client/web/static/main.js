// The operator's page: all parts are put together here.

import { state, watch } from "./store.js";
import { connect, heartbeat } from "./socket.js";
import { command } from "./commands.js";
import { startKeys } from "./keys.js";
import { startBar } from "./bar.js";
import { startCursors } from "./cursors.js";
import { startList } from "./list.js";
import { startFrame } from "./frame.js";
import { startHelp } from "./help.js";
import { startLayout } from "./layout.js";
import { startMap } from "./map.js";
import { startMatrix } from "./matrix.js";
import { startScene } from "./scene.js";
import { ImagePanel } from "./images.js";

const panels = [new ImagePanel(0), new ImagePanel(1)];
document.getElementById("images").append(...panels.map((panel) => panel.section));
const middle = (panel) => [panel.surface.width / 2, panel.surface.height / 2];
const zoom = (factor) => { const panel = panels[state.active]; panel.zoomBy(factor, state.cursors[state.active] && state.images[state.active] ? panel.toScreen(state.cursors[state.active]) : middle(panel)); };
command("zoom-in", () => zoom(1.5));
command("zoom-out", () => zoom(1 / 1.5));
command("fit", () => panels[state.active].fit());

const map = startMap(), matrix = startMatrix();
startScene();
startLayout();
startBar();
startList();
startFrame();
startHelp();
const reveal = () => panels.forEach((panel) => panel.reveal());
startCursors(reveal);
startKeys({ reveal, map: map.pan, matrix: matrix.step });
watch(["list"], () => { document.title = state.list.pair ? `${state.list.pair.join(" – ")} · fleetpose` : "fleetpose"; });

connect();
setInterval(heartbeat, 1000);
