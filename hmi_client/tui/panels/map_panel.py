"""The left panel: the fleet from above, in braille dots; the anchor stands at the centre."""

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from textual.strip import Strip

from fleetpose.hmi_client.desk.desk import Desk
from fleetpose.hmi_client.model.matrix import length_text, natural
from fleetpose.hmi_client.model.top_view import (
    ground_ellipse,
    heading_rad,
    layout,
    position,
    position_covariance,
)
from fleetpose.hmi_client.tui import bindings
from fleetpose.hmi_client.tui.drawing.cells import Canvas
from fleetpose.hmi_client.tui.drawing.palette import style
from fleetpose.hmi_client.tui.panels.panel import Do, Panel
from fleetpose.protocol.messages import RobotPose

Floats = npt.NDArray[np.float64]
HEADING_DOTS = 9
STEP = 1.25  # scales come in such steps, so that a moving robot does not repaint the whole map


@dataclass(frozen=True)
class Projection:
    """Metres on the ground (x right, y up) to braille dots (y down).

    Attributes:
        columns, rows: cells that there are.
        metres_per_dot: the scale.
        middle: what is at the centre, metres.
    """

    columns: int
    rows: int
    metres_per_dot: float
    middle: tuple[float, float] = (0.0, 0.0)

    def dots(self, xy: Floats) -> Floats:
        """(N, 2) metres to (N, 2) dots from the top left."""
        centre = np.array([self.columns, 2 * self.rows], float)
        return centre + (np.asarray(xy) - self.middle) * (1.0, -1.0) / self.metres_per_dot

    @classmethod
    def fitting(
        cls, columns: int, rows: int, xy: Floats, zoom: float = 1.0, margin: float = 0.8
    ) -> "Projection":
        """The finest scale of the ladder at which all points (N, 2) lie within the margin."""
        reach = np.abs(np.vstack((xy, np.zeros((1, 2))))).max(0)
        half = margin * np.array([columns, 2 * rows], float)
        wanted = max(float((reach / half).max()), 0.5 / float(half.min())) / zoom
        return cls(columns, rows, STEP ** math.ceil(math.log(wanted, STEP) - 1e-9))


def nice_length(metres: float) -> float:
    """The largest 1, 2 or 5 times a power of ten that is not above."""
    power = 10.0 ** math.floor(math.log10(metres))
    return max(step * power for step in (1, 2, 5) if step * power <= metres * (1 + 1e-9))


def _rounded(place: Floats) -> tuple[float, float]:
    """To decimetres: a pair that trembles does not repaint the whole map."""
    x, y = np.round(place, 1).tolist()
    return x, y


class MapPanel(Panel):
    """Position on the ground and heading of every robot, with its uncertainty (2 sigma)."""

    TOPICS = ("poses", "fleet", "selection")
    SLOW = ("fleet", "poses")
    BINDINGS = bindings.MAP  # pyright: ignore[reportAssignmentType]

    def __init__(self, desk: Desk, do: Do) -> None:
        super().__init__(id="map")
        self.desk, self.session, self._do = desk, desk.session, do
        self.zoom = 1.0
        self._middle = (0.0, 0.0)
        self._metres_per_dot = 1.0

    def action_do(self, command: str) -> None:
        """Zooms are the map's own; all else is done at the desk."""
        match command:
            case "zoom-in" | "zoom-out":
                factor = 1.5 if command == "zoom-in" else 1 / 1.5
                self.zoom = min(max(self.zoom * factor, 0.1), 100.0)
            case "fit":  # all robots, and (0, 0) at the centre
                self.zoom, self._middle, self.desk.following = 1.0, (0.0, 0.0), False
            case _:
                self._do(command)
        self.repaint()

    def action_arrow(self, right: int, down: int) -> None:
        """Pans by a sixteenth of the map, or more; it no longer follows anybody."""
        columns, rows = self.extent
        step = self._metres_per_dot * max(2 * columns, 4 * rows) / 16
        x, y = self._middle
        self._middle, self.desk.following = (x + right * step, y - down * step), False
        self.repaint()

    def _projection(self, places: dict[str, Floats]) -> Projection:
        columns, rows = max(self.extent.width, 1), max(self.extent.height - 3, 1)
        xy = np.array(list(places.values())).reshape(-1, 2)
        pair = [places[robot] for robot in self.session.pair or () if robot in places]
        if self.desk.following and pair:
            self._middle = middle = _rounded(np.mean(pair, axis=0))
            near = np.array(pair) - middle
            fitted = Projection.fitting(columns, rows, near, self.zoom, margin=0.5)
        else:
            fitted = Projection.fitting(columns, rows, xy, self.zoom)
        self._metres_per_dot = fitted.metres_per_dot
        return replace(fitted, middle=self._middle)

    def paint(self) -> list[Strip]:
        self.title("fleet from above" + (", following the pair" if self.desk.following else ""))
        poses, fleet = self.session.poses(), self.session.fleet
        columns, rows = self.extent
        places = layout(poses, fleet.anchor if fleet else None)
        projection = self._projection(places)
        canvas = Canvas(columns, rows)
        self._axes(canvas, projection)
        if self.desk.ellipses:
            for robot, place in places.items():
                self._ellipse(canvas, projection, poses[robot], place)
        order = sorted(places, key=lambda robot: (robot in (self.session.pair or ()), robot))
        for robot in order:
            self._robot(canvas, projection, poses[robot], places[robot])
        self._legend(canvas, projection, poses)
        return canvas.strips()

    def _axes(self, canvas: Canvas, projection: Projection) -> None:
        across, down = 2 * projection.columns, 4 * projection.rows
        centre = projection.dots(np.zeros((1, 2)))[0]
        xs = np.arange(centre[0] % 6, across, 6)
        ys = np.arange(centre[1] % 6, down, 6)
        canvas.dots(np.column_stack((xs, np.full_like(xs, centre[1]))), style("axes"))
        canvas.dots(np.column_stack((np.full_like(ys, centre[0]), ys)), style("axes"))

    def _ellipse(
        self, canvas: Canvas, projection: Projection, pose: RobotPose, place: Floats
    ) -> None:
        widest_m = 4.0 * math.sqrt(max(float(np.trace(position_covariance(pose)[:2, :2])), 0.0))
        if widest_m > 3 * projection.metres_per_dot:  # else it is smaller than the marker itself
            outline = ground_ellipse(pose, points=96) + place - position(pose)[:2]
            canvas.dots(projection.dots(outline), style("ellipse"))

    def _robot(
        self, canvas: Canvas, projection: Projection, pose: RobotPose, place: Floats
    ) -> None:
        selected = self.session.pair is not None and pose.robot in self.session.pair
        paint = (
            style("red text", bold=True)
            if selected
            else style("good", bold=True)
            if pose.located
            else style("plausible")
        )
        x, y = projection.dots(place[None])[0]
        heading = heading_rad(pose)
        steps = np.arange(2.0, HEADING_DOTS, 0.5)[:, None]
        arrow = np.array([[math.cos(heading), -math.sin(heading)]])
        canvas.dots((x, y) + steps * arrow, paint)
        column, row = int(x // 2), int(y // 4)
        canvas.text(column, row, "●" if pose.located else "○", paint)
        name = pose.robot if pose.located else f"{pose.robot}?"
        right, left = column + 2, column - 1 - len(name)
        sides = (left, right) if math.cos(heading) >= 0 else (right, left)
        spots = [(side, row) for side in sides] + [(column - 1, row - 1), (column - 1, row + 1)]
        free = [spot for spot in spots if canvas.is_free(*spot, len(name))]
        canvas.text(
            *(free or spots)[0], name, style("on red", "red", bold=True) if selected else paint
        )

    def _legend(self, canvas: Canvas, projection: Projection, poses: dict[str, RobotPose]) -> None:
        bar = nice_length(projection.metres_per_dot * 2 * canvas.columns / 4)
        cells = max(2, round(bar / projection.metres_per_dot / 2))
        bottom = canvas.rows - 1
        canvas.text(0, bottom, "├" + "─" * (cells - 2) + "┤ " + length_text(bar), style("dim"))
        key = "● located ○ not"
        if canvas.is_free(canvas.columns - len(key) - 1, bottom, len(key) + 1):
            canvas.text(canvas.columns - len(key), bottom, key, style("dim"))
        fleet = self.session.fleet
        absent = [r for r in self.session.robots() if r not in poses]
        if absent:
            canvas.text(
                0,
                bottom - 1,
                ("no pose: " + " ".join(absent))[: canvas.columns],
                style("plausible"),
            )
        anchor = fleet.anchor if fleet else None
        apart = sorted({p.component for p in poses.values()} - {anchor}, key=natural)
        if apart:
            members = {c: [r for r in poses if poses[r].component == c] for c in apart}
            words = "; ".join(" ".join(sorted(members[c], key=natural)) for c in apart)
            canvas.text(
                0, bottom - 2, f"separate: {words}"[: canvas.columns], style("apart", bold=True)
            )
        if fleet is not None:
            origin = f"origin {fleet.anchor or 'none'}"
            ups = (", up is the camera's", ", camera's up") if fleet.up_assumed else (", z up",)
            fits = (up for up in ups if len(origin + up) <= canvas.columns)
            text = origin + next(fits, "")
            canvas.text(0, 0, text[: canvas.columns], style("dim"))
