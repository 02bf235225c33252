"""Pose graphs as g2o writes them (Kümmerle et al. 2011): `VERTEX_SE3:QUAT`, `EDGE_SE3:QUAT`, `FIX`.

An edge's error is e = log(T_measured^-1 T_a_b), translation first; its rotation is told by the
vector part of the quaternion, which is **half** the angle (g2o's `toVectorMQT`). An information
matrix on angles therefore has its rotation block times 4 in the file, and the blocks between
rotation and translation times 2. gtsam reads and writes the same lines with whole angles; who
reads a file of these with gtsam gives `half_angles=False` here, or divides.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fleetpose.formats.arrays import Floats, FormatError
from fleetpose.formats.rotations import pose_of, quat_wxyz
from fleetpose.formats.text import joined, lines_of, numbers_of

VERTEX, EDGE, FIX = "VERTEX_SE3:QUAT", "EDGE_SE3:QUAT", "FIX"
_POSE, _INFORMATION = 7, 21  # numbers; the upper triangle of 6x6, row by row
_TRANSLATION_FIRST = np.r_[3:6, 0:3]
_HALF = np.repeat((1.0, 2.0), 3)  # of a file's order: an angle is twice what the file calls it
_MOST_ID = 2**64  # gtsam puts the letter of a robot into the highest byte


@dataclass(frozen=True, eq=False)
class PoseEdge:
    """A measured T_a_b (4, 4) between two vertices, and its information (6, 6), rotation then
    translation, on right perturbations, `T_a_b exp(xi)`; radians and metres.
    """

    a: int
    b: int
    T_a_b: Floats
    information: Floats


@dataclass(frozen=True, eq=False)
class PoseGraph:
    """Vertices' poses (4, 4) in the graph's frame by number, edges, and the vertices held still."""

    poses: Mapping[int, Floats]
    edges: Sequence[PoseEdge]
    fixed: tuple[int, ...] = ()


def write_g2o(path: Path, graph: PoseGraph, half_angles: bool = True) -> None:
    """Writes a graph.

    Args:
        half_angles: as g2o has it; gtsam's way if not.

    Raises:
        OSError: it cannot be written.
    """
    lines = [f"{VERTEX} {number} {_pose_text(T)}" for number, T in graph.poses.items()]
    lines += [f"{FIX} {number}" for number in graph.fixed]
    upper = np.triu_indices(6)
    for edge in graph.edges:
        information = edge.information[np.ix_(_TRANSLATION_FIRST, _TRANSLATION_FIRST)]
        if half_angles:
            information = information * np.outer(_HALF, _HALF)
        numbers = f"{_pose_text(edge.T_a_b)} {joined(information[upper])}"
        lines.append(f"{EDGE} {edge.a} {edge.b} {numbers}")
    path.write_text("".join(f"{line}\n" for line in lines))


def read_g2o(path: Path, half_angles: bool = True) -> PoseGraph:
    """Reads a graph; other kinds of lines are left out, as g2o does with those it does not know.

    Args:
        half_angles: how the file was written.

    Raises:
        FormatError: it cannot be read, or a line says what cannot be; the text names it.
    """
    poses: dict[int, Floats] = {}
    edges, fixed = [], []
    for number, line in enumerate(lines_of(path), 1):
        tag, *words = line.split() or [""]
        where = f"{path}, line {number}"
        if tag == VERTEX:
            (vertex,), values = _parsed(path, where, words, 1, _POSE)
            poses[vertex] = _pose(where, values)
        elif tag == EDGE:
            (a, b), values = _parsed(path, where, words, 2, _POSE + _INFORMATION)
            information = _information(values[_POSE:], half_angles)
            edges.append(PoseEdge(a, b, _pose(where, values[:_POSE]), information))
        elif tag == FIX:
            ids, _ = _parsed(path, where, words, len(words), 0)
            fixed += ids
    return PoseGraph(poses, edges, tuple(fixed))


def _pose_text(T: Floats) -> str:
    w, x, y, z = quat_wxyz(T[:3, :3])
    return joined(np.array([*T[:3, 3], x, y, z, w]))


def _pose(where: str, values: Floats) -> Floats:
    if not values[3:].any():
        raise FormatError(f"{where}: a quaternion of zeros is no rotation")
    return pose_of(values[[6, 3, 4, 5]], values[:3])


def _information(values: Floats, half_angles: bool) -> Floats:
    upper = np.zeros((6, 6))
    upper[np.triu_indices(6)] = values
    whole = upper + np.triu(upper, 1).T
    if half_angles:
        whole = whole / np.outer(_HALF, _HALF)
    back = np.argsort(_TRANSLATION_FIRST)
    return whole[np.ix_(back, back)]


def _parsed(
    path: Path, where: str, words: Sequence[str], ids: int, numbers: int
) -> tuple[list[int], Floats]:
    """The vertices and the numbers of a line."""
    if len(words) != ids + numbers:
        raise FormatError(f"{where} has {len(words)} numbers, need {ids + numbers}")
    if not all(word.isdigit() and len(word) <= 20 and int(word) < _MOST_ID for word in words[:ids]):
        raise FormatError(f"{where}: a vertex is no number")
    return [int(word) for word in words[:ids]], numbers_of(path, " ".join(words[ids:]))
