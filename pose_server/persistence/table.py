"""Correspondences as JSON and as CSV: what both formats hold, written and read."""

import csv
import json
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from fleetpose.pose_server.correspondences.store import Kept
from fleetpose.protocol.errors import FleetPoseError
from fleetpose.protocol.keys import ordered_pair
from fleetpose.protocol.messages import ViewName
from fleetpose.protocol.messages.fields import Count, Epoch, Name

SCHEMA = "fleetpose.correspondences.v1"
_SIDE = ("robot", "epoch", "seq", "u", "v", "x_m", "y_m", "z_m")
COLUMNS = (
    "id",
    "operator",
    *(f"{name}_i" for name in _SIDE),
    *(f"{name}_j" for name in _SIDE),
    "status",
    "residual_m",
    "residual_px",
)
"""Pixels of the full image; points in the camera frame of their view, metres."""


class TableError(FleetPoseError):
    """A file that holds no correspondences."""


class Click(BaseModel):
    """What reading takes from a row: two pixels, the rest is worked out again."""

    model_config = ConfigDict(extra="ignore", frozen=True)

    operator: Name
    robot_i: Name
    epoch_i: Epoch
    seq_i: Count
    u_i: float = Field(allow_inf_nan=False)
    v_i: float = Field(allow_inf_nan=False)
    robot_j: Name
    epoch_j: Epoch
    seq_j: Count
    u_j: float = Field(allow_inf_nan=False)
    v_j: float = Field(allow_inf_nan=False)

    @property
    def ends(self) -> list[tuple[ViewName, tuple[float, float]]]:
        """View and pixel of both ends, in order of the robots' names."""
        i = ViewName(robot=self.robot_i, epoch=self.epoch_i, seq=self.seq_i)
        j = ViewName(robot=self.robot_j, epoch=self.epoch_j, seq=self.seq_j)
        ends = [(i, (self.u_i, self.v_i)), (j, (self.u_j, self.v_j))]
        in_order = ordered_pair(self.robot_i, self.robot_j) == (self.robot_i, self.robot_j)
        return ends if in_order else ends[::-1]


@dataclass(frozen=True)
class Row:
    """One row of a file: where it stands, and what it says or why it cannot be read."""

    place: str
    click: Click | None
    problem: str = ""


def write_json(path: Path, items: Sequence[Kept], **about: Any) -> None:
    """Writes correspondences and what else is to be told of the session."""
    rows = [_cells(kept) for kept in items]
    text = json.dumps({"schema": SCHEMA, **about, "correspondences": rows}, indent=1)
    path.write_text(text + "\n")


def write_csv(path: Path, items: Iterable[Kept]) -> None:
    """Writes correspondences, one per line."""
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS)
        writer.writeheader()
        writer.writerows(_cells(kept) for kept in items)


def read_rows(path: Path) -> Iterator[Row]:
    """The rows of a JSON or a CSV file, by its name's ending.

    Raises:
        TableError: it cannot be read, or is neither.
    """
    try:
        if path.suffix.lower() == ".json":
            yield from (_row(f"{path.name}, item {n}", x) for n, x in enumerate(_items(path), 1))
            return
        with path.open(newline="") as file:
            reader = csv.DictReader(file)
            missing = set(Click.model_fields) - set(reader.fieldnames or ())
            if missing:
                raise TableError(
                    f"{path}: no column {', '.join(sorted(missing))}; the first line names the "
                    "columns, as `pose-server export` writes them"
                )
            yield from (_row(f"{path.name}, line {reader.line_num}", cells) for cells in reader)
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise TableError(f"{path} cannot be read: {error}") from error


def _items(path: Path) -> list[Any]:
    try:
        content = json.loads(path.read_text())
    except (ValueError, RecursionError) as error:
        raise TableError(f"{path} is no JSON: {error}") from error
    items = content.get("correspondences") if isinstance(content, dict) else None
    if not isinstance(items, list) or content.get("schema") != SCHEMA:
        raise TableError(f"{path} holds no correspondences: need schema {SCHEMA}")
    return items


def _row(place: str, cells: Any) -> Row:
    try:
        return Row(place, Click.model_validate(cells))
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"])) or "the row"
        return Row(place, None, f"{where}: {first['msg']}")


def _cells(kept: Kept) -> dict[str, Any]:
    item = kept.item
    cells: dict[str, Any] = {"id": item.id, "operator": item.operator}
    sides = (("i", item.view_i, item.pixel_i, kept.p_i), ("j", item.view_j, item.pixel_j, kept.p_j))
    for side, view, pixel, point in sides:
        values = (view.robot, view.epoch, view.seq, *map(float, pixel), *map(float, point))
        cells |= {f"{name}_{side}": value for name, value in zip(_SIDE, values, strict=True)}
    told = {"status": item.status, "residual_m": item.residual_m, "residual_px": item.residual_px}
    return cells | told
