"""What was understood of a camera, by one of its frames: a wrong unit, size or lens shows here
before it shows in a pose.
"""

from dataclasses import dataclass

import numpy as np

from fleetpose.robot_agent.cameras.base import DepthImage, DisparityImage, Frame, ScatteredPoints

THIN_DEPTH = 0.1
"""Share of the pixels with depth below which something is wrong: good stereo rigs gave 0.6 to 0.9,
eyes that had changed places 0.04, a lost eye 0."""


@dataclass(frozen=True)
class Understood:
    """Attributes:
    size: width, height, px.
    f_px: focal length.
    baseline_m: of stereo; None of others.
    share: of the pixels that have depth; None where the points lie on no grid.
    depths_m: 5th percentile, median and 95th percentile; empty where there is no depth.
    points: with depth.
    """

    size: tuple[int, int]
    f_px: float
    baseline_m: float | None
    share: float | None
    depths_m: tuple[float, ...]
    points: int

    @property
    def wide_deg(self) -> float:
        """The horizontal field of view."""
        return float(np.degrees(2 * np.arctan(self.size[0] / (2 * self.f_px))))

    @property
    def is_thin(self) -> bool:
        """Whether there is so little depth that something is wrong."""
        return not self.points if self.share is None else self.share < THIN_DEPTH

    def __str__(self) -> str:
        width, height = self.size
        parts = [f"{width}x{height} px", f"f {self.f_px:.0f} px = {self.wide_deg:.0f} deg wide"]
        if self.baseline_m is not None:
            parts.append(f"baseline {self.baseline_m:.3g} m")
        if self.depths_m:
            near, middle, far = self.depths_m
            parts.append(f"depths {near:.2g} to {far:.2g} m, half of them beyond {middle:.2g}")
        if self.share is not None:
            parts.append(f"{self.share:.0%} of the pixels have depth")
        else:
            parts.append(f"{self.points} points have depth")
        return ", ".join(parts)


def understood_of(frame: Frame) -> Understood:
    """What a frame shows of its camera."""
    model, ranges = frame.model, frame.ranges
    baseline_m = None
    if isinstance(ranges, DepthImage):
        grid, depths = ranges.depth_m.size, ranges.depth_m
    elif isinstance(ranges, DisparityImage):
        good = np.where(ranges.disparity_px > 0, ranges.disparity_px, np.nan)
        grid, depths = good.size, ranges.focal_baseline_px_m / good
        baseline_m = ranges.focal_baseline_px_m / float(model.K[0, 0])
    else:
        assert isinstance(ranges, ScatteredPoints)
        grid, depths = None, ranges.z
    z = depths[np.isfinite(depths)]
    return Understood(
        size=(model.width, model.height),
        f_px=float(model.K[0, 0]),
        baseline_m=baseline_m,
        share=None if grid is None else z.size / grid,
        depths_m=tuple(map(float, np.percentile(z, (5, 50, 95)))) if z.size else (),
        points=int(z.size),
    )
