"""RGB-D folders with lists, as other systems, units and clocks leave them."""

from functools import partial
from pathlib import Path

import numpy as np
import numpy.typing as npt

from fleetpose.evaluation.bench.cameras.made.scene import save
from fleetpose.evaluation.bench.cameras.made.variants import Variant

Depth = npt.NDArray[np.float32]
_K = "262.5 0 159.5\n0 262.5 119.5\n0 0 1\n"
_COUNT = 3
_FIRST_S = 1305031102.175304


def true_depth(nearest_m: float = 1.2, furthest_m: float = 4.0) -> Depth:
    """A wall that leans away."""
    columns = np.linspace(nearest_m, furthest_m, 320, dtype=np.float32)
    return np.tile(columns, (240, 1))


def colour() -> npt.NDArray[np.uint8]:
    """Something to look at."""
    return np.random.default_rng(0).integers(60, 200, (240, 320, 3), np.uint8)


def _stamp(at_s: float, unit: str) -> str:
    if unit == "s":
        return f"{at_s:.6f}"
    return str(round(at_s * {"ms": 1e3, "us": 1e6, "ns": 1e9}[unit]))


def _listed(
    folder: Path,
    encoding: str = "utf-8",
    newline: str = "\n",
    between: str = " ",
    unit: str = "s",
    late_s: float = 0.004,
    steps: float = 5000.0,
    header: str = "# timestamp filename",
    depth_m: Depth | None = None,
    matrix: str = _K,
    name: str = "camera-intrinsics.txt",
) -> Depth:
    """A folder with rgb.txt and depth.txt."""
    depth_m = true_depth() if depth_m is None else depth_m
    for kind, late in (("rgb", 0.0), ("depth", late_s)):
        lines = [header] if header else []
        for n in range(_COUNT):
            image = colour() if kind == "rgb" else np.rint(depth_m * steps).astype(np.uint16)
            save(folder / f"{kind}/{n}.png", image)
            at = _stamp(_FIRST_S + 0.2 * n + late, unit)
            lines.append(between.join((at, f"{kind}/{n}.png")))
        text = newline.join(lines) + newline
        (folder / f"{kind}.txt").write_bytes(text.encode(encoding))
    (folder / name).write_text(matrix)
    return depth_m


def _loose(folder: Path, steps: float, name: str = "7scenes") -> Depth:
    """7-Scenes' names, or two folders, in another unit than theirs."""
    depth_m = true_depth(0.5, 2.5)
    for n in range(_COUNT):
        raw = np.rint(depth_m * 1000).astype(np.uint16) * np.uint16(steps / 1000)
        if name == "7scenes":
            save(folder / f"frame-{n:06d}.color.png", colour())
            save(folder / f"frame-{n:06d}.depth.png", raw)
        else:
            save(folder / f"color/{n}.png", colour())
            save(folder / f"depth/{n}.png", raw)
    (folder / "camera-intrinsics.txt").write_text(_K)
    return depth_m


def _lists(name: str, refused: str | None = None, **how: object) -> Variant:
    options = {"depth_scale": 1000.0} if how.pop("told", False) else {}
    write = partial(_listed, **how)  # pyright: ignore[reportArgumentType]
    return Variant(f"lists_{name}", "rgbd", write, refused, _COUNT, options)


VARIANTS: tuple[Variant, ...] = (
    _lists("plain"),
    _lists("byte_order_mark", encoding="utf-8-sig"),
    _lists("utf_16", encoding="utf-16"),
    _lists("crlf", newline="\r\n"),
    _lists("csv", between=",", header="timestamp,filename"),
    _lists("csv_with_spaces", between=", "),
    _lists("semicolons", between=";"),
    _lists("tabs", between="\t"),
    _lists("no_header", header=""),
    _lists("header_without_mark", header="timestamp filename"),
    _lists("ms", unit="ms"),
    _lists("us", unit="us"),
    _lists("ns", unit="ns"),
    _lists("25_ms_apart", late_s=0.025, refused=r"25 ms"),
    _lists("offset_clock", late_s=3600.0, refused=r"ms apart"),
    _lists("mm", steps=1000.0, refused="depth-scale"),
    _lists("mm_far", steps=1000.0, depth_m=true_depth(2.0, 8.0), refused="depth-scale"),
    _lists("mm_told", steps=1000.0, told=True),
    _lists("fy_negative", matrix=_K.replace("0 262.5 1", "0 -262.5 1"), refused="below 0"),
    _lists("fx_negative", matrix="-262.5 262.5 159.5 119.5", refused="below 0"),
    _lists("matrix_in_commas", matrix=_K.replace(" ", ", ")),
    _lists("four_numbers", matrix="262.5 262.5 159.5 119.5\r\n"),
    _lists("matrix_of_another_size", matrix="525 525 319.5 239.5", refused="640x480"),
    Variant("mm_in_seven_scenes", "rgbd", partial(_loose, steps=1000), None, _COUNT),
    Variant("fifths_in_seven_scenes", "rgbd", partial(_loose, steps=5000), "depth-scale", _COUNT),
    Variant(
        "fifths_in_two_folders",
        "rgbd",
        partial(_loose, steps=5000, name="two"),
        "depth-scale",
        _COUNT,
    ),
)
