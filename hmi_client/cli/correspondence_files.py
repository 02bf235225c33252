"""Correspondences in files: CSV and JSON, one record each, with the views they were clicked in."""

import csv
import json
import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from fleetpose.hmi_client.errors import OperatorError
from fleetpose.hmi_client.model.records import Entry, Pair, Pick
from fleetpose.hmi_client.model.session import OperatorSession
from fleetpose.protocol.messages import ViewName

FIELDS = (
    *("i", "j", "view_i", "view_j", "u_i", "v_i", "u_j", "v_j"),
    *("id", "status", "residual_m", "residual_px"),
)
"""Columns; views are `robot/epoch/seq`. Reading needs the robots and pixels only."""


def record_of(pair: Pair, entry: Entry) -> dict[str, Any]:
    """A list entry as a record."""
    pick = entry.pick
    return {
        "i": pair[0],
        "j": pair[1],
        "view_i": str(pick.view_i),
        "view_j": str(pick.view_j),
        "u_i": pick.pixel_i[0],
        "v_i": pick.pixel_i[1],
        "u_j": pick.pixel_j[0],
        "v_j": pick.pixel_j[1],
        "id": entry.id,
        "status": entry.status,
        "residual_m": entry.residual_m,
        "residual_px": entry.residual_px,
    }


def write_records(path: Path, records: Iterable[dict[str, Any]]) -> None:
    """Writes CSV or JSON, by the file's ending.

    Raises:
        OperatorError: another ending, or the file cannot be written.
    """
    kind = _kind(path)
    try:
        with path.open("w", newline="", encoding="utf-8") as file:
            if kind == ".json":
                json.dump(list(records), file, indent=1)
                file.write("\n")
            else:
                writer = csv.DictWriter(file, FIELDS)
                writer.writeheader()
                writer.writerows(records)
    except OSError as error:
        raise OperatorError(f"{path} cannot be written: {error.strerror}") from error


def read_records(path: Path) -> list[dict[str, Any]]:
    """Reads CSV or JSON, by the file's ending.

    Raises:
        OperatorError: the file is missing, of another kind, or no list of records.
    """
    kind = _kind(path)
    try:
        with path.open(newline="", encoding="utf-8") as file:
            records = json.load(file) if kind == ".json" else list(csv.DictReader(file))
    except OSError as error:
        raise OperatorError(f"{path} cannot be read: {error.strerror}") from error
    except (ValueError, csv.Error) as error:
        raise OperatorError(f"{path} is no valid {kind[1:].upper()}: {error}") from error
    if not isinstance(records, list) or not all(isinstance(r, dict) for r in records):
        raise OperatorError(f"{path} must hold a list of correspondences")
    return records


def pick_of(record: dict[str, Any], session: OperatorSession, place: str) -> Pick:
    """A record as a pick; robots may come in either order, a missing view is the newest one.

    Raises:
        OperatorError: a field is missing or no number; `place` names the record.
    """
    try:
        i, j = str(record["i"]), str(record["j"])
        u_i, v_i, u_j, v_j = (float(record[name]) for name in ("u_i", "v_i", "u_j", "v_j"))
    except (KeyError, TypeError, ValueError) as error:
        needs = "it needs robots i, j and numbers u_i, v_i, u_j, v_j"
        raise OperatorError(f"{place}: {needs} ({error})") from error
    if not all(math.isfinite(x) for x in (u_i, v_i, u_j, v_j)):
        raise OperatorError(f"{place}: a pixel is not finite")
    if i == j:
        raise OperatorError(f"{place}: '{i}' cannot correspond to itself")
    view_i = view_of(session, i, record.get("view_i"), place)
    view_j = view_of(session, j, record.get("view_j"), place)
    return Pick.of(view_i, (u_i, v_i), view_j, (u_j, v_j))


def view_of(session: OperatorSession, robot: str, text: Any, place: str) -> ViewName:
    """A view by its text `robot/epoch/seq`, or the robot's newest view if there is none.

    Raises:
        OperatorError: the text names no view of the robot, or the robot has sent none.
    """
    if not text:
        newest = session.robot(robot).newest_view
        if newest is None:
            raise OperatorError(f"{place}: {robot} has sent no view yet")
        return newest
    try:
        name, epoch, seq = str(text).split("/")
        view = ViewName(robot=name, epoch=epoch, seq=int(seq))
    except ValueError as error:
        raise OperatorError(f"{place}: '{text}' is no view; write robot/epoch/seq") from error
    if view.robot != robot:
        raise OperatorError(f"{place}: view '{text}' is not of {robot}")
    return view


def _kind(path: Path) -> str:
    kind = path.suffix.lower()
    if kind not in (".csv", ".json"):
        raise OperatorError(f"{path}: the file's ending must be .csv or .json")
    return kind
