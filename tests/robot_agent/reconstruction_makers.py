"""One small reconstruction, as COLMAP, Bundler and VisualSfM would write it."""

import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np

K1, K2, D = -0.05, 0.01, -0.06  # of COLMAP and Bundler; VisualSfM's, which goes the other way
COLOUR = (10, 20, 30)
UNSEEN = 5  # a point that no photo saw
ID = 7  # COLMAP's ids are not places


@dataclass(frozen=True)
class Scene:
    """What is true: cameras have OpenCV axes and look at points before them."""

    cameras: int = 3
    focal_px: float = 500.0
    size: tuple[int, int] = (320, 240)
    points: np.ndarray = field(
        default_factory=lambda: np.random.default_rng(0).uniform(
            (-1, -0.8, 4), (1, 0.8, 6), (30, 3)
        )
    )

    def pose(self, k: int) -> tuple[np.ndarray, np.ndarray]:
        """Rotation and translation from the world to camera k."""
        R, _ = cv2.Rodrigues(np.array([0.02 * k, -0.05 * k, 0.01]))
        return R, np.array([0.1 * k, 0.0, 0.1])

    def rays(self, k: int) -> np.ndarray:
        """(P, 2) x / z and y / z in camera k."""
        R, t = self.pose(k)
        p = self.points @ R.T + t
        return p[:, :2] / p[:, 2:]

    def distorted(self, k: int) -> np.ndarray:
        """(P, 2) px from the middle of the image, y down, of a camera with K1 and K2."""
        rays = self.rays(k)
        r2 = (rays**2).sum(axis=1, keepdims=True)
        return self.focal_px * (1 + K1 * r2 + K2 * r2**2) * rays

    def quat_wxyz(self, k: int) -> np.ndarray:
        """Of the rotation of `pose`."""
        turn = cv2.Rodrigues(self.pose(k)[0])[0][:, 0]
        angle = np.linalg.norm(turn)
        return np.array([np.cos(angle / 2), *(np.sin(angle / 2) * turn / angle)])


SCENE = Scene()
NAMES = [f"photo{k}.jpg" for k in range(SCENE.cameras)]


def write_images(
    folder: Path, names: list[str] = NAMES, size: tuple[int, int] = SCENE.size
) -> None:
    """Grey ones."""
    width, height = size
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(folder / name), np.full((height, width, 3), 90, np.uint8))


def words(*numbers) -> str:
    return " ".join(repr(float(n)) if isinstance(n, float) else str(n) for n in numbers)


def tracks(pixels: Callable[[int], np.ndarray]) -> list[str]:
    """Each point as Bundler and VisualSfM write it, but for its place and colour."""
    seen = [pixels(k) for k in range(SCENE.cameras)]
    lines = []
    for n in range(len(SCENE.points)):
        views = [words(k, n, *seen[k][n]) for k in range(SCENE.cameras) if n != UNSEEN]
        lines.append(" ".join((str(len(views)), *views)))
    return lines


def bundler_text() -> str:
    turn = np.diag((1.0, -1.0, -1.0))  # Bundler looks down -z, y is up
    lines = ["# Bundle file v0.3", f"{SCENE.cameras} {len(SCENE.points)}"]
    for k in range(SCENE.cameras):
        R, t = SCENE.pose(k)
        lines += [
            words(SCENE.focal_px, K1, K2),
            *(words(*row) for row in turn @ R),
            words(*turn @ t),
        ]
    views = tracks(lambda k: SCENE.distorted(k) * (1.0, -1.0))
    for point, seen in zip(SCENE.points, views, strict=True):
        lines += [words(*point), words(*COLOUR), seen]
    return "\n".join(lines) + "\n"


def measured_by_visualsfm(k: int) -> np.ndarray:
    """(P, 2) the m with (1 + D m^2) m = ray, by the cubic's root, in px."""
    rays = SCENE.rays(k)
    u = np.linalg.norm(rays, axis=1)
    roots = [np.roots((D, 0.0, 1.0, -one)) for one in u]
    m = [min(r.real for r in each if abs(r.imag) < 1e-9 and r.real > 0) for each in roots]
    return SCENE.focal_px * rays * (np.array(m) / u)[:, None]


def nvm_text(header: str = "NVM_V3 ") -> str:
    lines = [header, "", str(SCENE.cameras)]
    for k, name in enumerate(NAMES):
        R, t = SCENE.pose(k)
        numbers = words(SCENE.focal_px, *SCENE.quat_wxyz(k), *(-R.T @ t), D, 0)
        lines.append(f"{name}\t{numbers} ")
    lines += ["", str(len(SCENE.points))]
    for point, seen in zip(SCENE.points, tracks(measured_by_visualsfm), strict=True):
        lines.append(f"{words(*point, *COLOUR)} {seen} ")
    other = ["1", "other.jpg\t500 1 0 0 0 0 0 0 0 0 ", "0", "", "0", "", "#the last part", "0"]
    return "\n".join((*lines, "", *other)) + "\n"


def colmap_camera(model: str = "RADIAL") -> tuple[str, list[float]]:
    """A model and its parameters, all of the same camera as far as the model goes."""
    width, height = SCENE.size
    f, centre = SCENE.focal_px, [width / 2, height / 2]
    return model, {
        "RADIAL": [f, *centre, K1, K2],
        "OPENCV": [f, f, *centre, K1, K2, 0.0, 0.0],
        "FULL_OPENCV": [f, f, *centre, K1, K2, *[0.0] * 6],
    }[model]


def colmap_keypoints(k: int) -> list[tuple[float, ...]]:
    """Of an image: x, y, point; the first one is none."""
    middle = np.array(SCENE.size) / 2
    seen = [(*map(float, at), ID + n) for n, at in enumerate(SCENE.distorted(k) + middle)]
    return [(1.0, 2.0, -1), *seen[:UNSEEN], *seen[UNSEEN + 1 :]]


def write_colmap_text(folder: Path, model: str = "RADIAL") -> None:
    folder.mkdir(parents=True, exist_ok=True)
    name, parameters = colmap_camera(model)
    cameras = ["# Camera list", "# Number of cameras: 1", words(4, name, *SCENE.size, *parameters)]
    images = [
        "# Image list",
        f"# Number of images: {SCENE.cameras}, mean observations per image: 29",
    ]
    for k in reversed(range(SCENE.cameras)):
        images += [words(k + 1, *SCENE.quat_wxyz(k), *SCENE.pose(k)[1], 4, NAMES[k])]
        images += [" ".join(words(*one) for one in colmap_keypoints(k))]
    points = [f"# Number of points: {len(SCENE.points)}, mean track length: 3"]
    for n, point in enumerate(SCENE.points):
        points += [
            words(ID + n, *point, *COLOUR, 0.1, *([] if n == UNSEEN else [1, n, 2, n, 3, n]))
        ]
    for stem, lines in (("cameras", cameras), ("images", images), ("points3D", points)):
        (folder / f"{stem}.txt").write_text("\n".join(lines) + "\n")


def write_colmap_binary(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    radial = 3
    cameras = struct.pack("<QiiQQ5d", 1, 4, radial, *SCENE.size, *colmap_camera()[1])
    images = struct.pack("<Q", SCENE.cameras)
    for k, name in enumerate(NAMES):
        pose, keypoints = (*SCENE.quat_wxyz(k), *SCENE.pose(k)[1]), colmap_keypoints(k)
        images += struct.pack("<i7di", k + 1, *pose, 4) + name.encode() + b"\0"
        images += struct.pack("<Q", len(keypoints))
        images += b"".join(struct.pack("<ddq", *one) for one in keypoints)
    points = struct.pack("<Q", len(SCENE.points))
    for n, point in enumerate(SCENE.points):
        track = () if n == UNSEEN else (1, n, 2, n, 3, n)
        points += struct.pack("<Q3d3BdQ", ID + n, *point, *COLOUR, 0.1, len(track) // 2)
        points += struct.pack(f"<{len(track)}i", *track)
    for stem, content in (("cameras", cameras), ("images", images), ("points3D", points)):
        (folder / f"{stem}.bin").write_bytes(content)


def write_bundler(folder: Path, text: str | None = None, inside: str = "") -> Path:
    (folder / inside).mkdir(exist_ok=True)
    (folder / inside / "bundle.out").write_text(bundler_text() if text is None else text)
    write_images(folder)
    return folder


def write_nvm(folder: Path, text: str | None = None) -> Path:
    (folder / "model.nvm").write_text(nvm_text() if text is None else text)
    write_images(folder)
    return folder


def write_colmap(folder: Path, binary: bool = False, inside: str = "sparse/0") -> Path:
    (write_colmap_binary if binary else write_colmap_text)(folder / inside)
    write_images(folder / "images")
    return folder


WRITERS: dict[str, Callable[[Path], Path]] = {
    "bundler": write_bundler,
    "nvm": write_nvm,
    "colmap text": write_colmap,
    "colmap binary": lambda folder: write_colmap(folder, binary=True),
}
