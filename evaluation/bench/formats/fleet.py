"""A small fleet whose files are compared: two robots in the synthetic town, put together by the
server's own pipeline.
"""

from pathlib import Path

import cv2

from fleetpose.evaluation.bench.bags.scenes import Scene, walks
from fleetpose.evaluation.bench.published.layouts import open_sequence
from fleetpose.evaluation.bench.published.sequences import RecordedSequence
from fleetpose.formats.text import seconds_of
from fleetpose.formats.tum import tum_line

_STEPS_PER_M = 5.0  # of a millimetre, as TUM writes depths


def sequences(robots: int, frames: int, folder: Path) -> list[RecordedSequence]:
    """Folders as the TUM benchmark lays them out, opened as its robots."""
    names = [f"walk{k}" for k in range(robots)]
    for name, scene in zip(names, walks(robots, frames), strict=True):
        _write(folder / name, scene)
    return [open_sequence("tum", folder, name) for name in names]


def _write(folder: Path, scene: Scene) -> None:
    for part in ("rgb", "depth"):
        (folder / part).mkdir(parents=True)
    images = {"rgb": scene.colours, "depth": [d * int(_STEPS_PER_M) for d in scene.depths_mm]}
    for part, arrays in images.items():
        lines = []
        for at_ns, array in zip(scene.stamps_ns, arrays, strict=True):
            name = f"{part}/{seconds_of(at_ns)}.png"
            cv2.imwrite(str(folder / name), array)
            lines.append(f"{seconds_of(at_ns)} {name}\n")
        (folder / f"{part}.txt").write_text("".join(lines))
    poses = zip(scene.stamps_ns, scene.T_world_cameras, strict=True)
    truth = "".join(f"{tum_line(at_ns, T)}\n" for at_ns, T in poses)
    (folder / "groundtruth.txt").write_text(truth)
    rows = "\n".join(" ".join(map(str, row)) for row in scene.K)
    (folder / "camera-intrinsics.txt").write_text(rows + "\n")
