"""Help for the operator's hand: where to put the cursor, in the pictures that are held still.

What it says is a place to look at. Only the operator picks.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fleetpose.hmi_client.assist import picking
from fleetpose.hmi_client.errors import OperatorError, PictureError
from fleetpose.hmi_client.model.depths import Depths
from fleetpose.hmi_client.model.picture_decoder import GreyImages, Image
from fleetpose.hmi_client.model.records import PixelUV
from fleetpose.hmi_client.model.session import OperatorSession
from fleetpose.protocol.messages import ViewName

Floats = npt.NDArray[np.float64]
_LOOKS_KEPT = 4
_SAME_PX = 8.0  # a suggestion nearer to a point that was clicked adds nothing


@dataclass(frozen=True)
class Expected:
    """Where the other half of a pick is to be expected.

    Attributes:
        side: in which image.
        pixel: where.
        how: what says so, in words.
        segment: both ends of the line on which it lies, where its depth is not known.
    """

    side: int
    pixel: PixelUV
    how: str
    segment: tuple[PixelUV, PixelUV] | None = None


class PickAssist:
    """Looks at the held pictures of a session."""

    def __init__(self, session: OperatorSession) -> None:
        self._session = session
        self._greys = GreyImages()
        self._looks: dict[ViewName, picking.Looks] = {}

    # ---- one image -------------------------------------------------------------------------------

    def snap(self, side: int, pixel: PixelUV) -> PixelUV:
        """The corner near a pixel; among scattered points the nearest one that has depth.

        Raises:
            OperatorError: there is nothing to snap to.
        """
        depths = self._depths(side)
        if depths is not None and depths.scattered:
            nearest = depths.nearest(pixel)
            if nearest is None:
                raise OperatorError("no point of this view has depth")
            return nearest.pixel
        grey = self._grey(side)
        corner = None if grey is None else picking.snap_to_corner(grey, pixel)
        if corner is None:
            raise OperatorError(f"no corner within {picking.SNAP_PX} px of the cursor")
        return corner

    def places(self, side: int, least_u: float, least_v: float, at_most: int) -> list[PixelUV]:
        """Pixels worth a pick: with depth as far as that is known, and so far from each other. For
        the first half of a point the strongest corners come first, for the other half those that
        look most like the first one.
        """
        grey, depths = self._grey(side), self._depths(side)
        if grey is None:
            return []
        half = self._session.half
        first = self._grey(half.side) if half is not None and half.side != side else None
        if depths is not None and depths.scattered:
            uv = depths.uv[picking.by_strength(grey, depths.uv)]
        else:
            apart_px = 3.0 if first is not None else max(min(least_u, least_v) / 2, 3.0)
            uv = picking.corners(grey, apart_px)
            if depths is not None:
                uv = uv[[depths.has((u, v)) for u, v in uv.tolist()]] if len(uv) else uv
        if half is not None and first is not None:
            look, near = picking.look_at(first, half.pixel), self._by_clicks(half.side, half.pixel)
            uv = uv[picking.by_likeness(grey, uv, look, near)]
        chosen = picking.apart(uv, least_u, least_v, at_most)
        return [(float(u), float(v)) for u, v in uv[chosen]]

    def prepare(self) -> None:
        """Finds what both pictures look like, so that it is there once a half is picked."""
        for side in (0, 1):
            self._looks_of(side)

    # ---- the other image -------------------------------------------------------------------------

    def expected(self) -> Expected | None:
        """Where the other half of the half pick is: by the poses of both robots, else by what it
        looks like, near where the points clicked so far would put it; none where nothing tells.
        """
        session, half = self._session, self._session.half
        if half is None or session.pair is None:
            return None
        other = 1 - half.side
        by_pose = self._by_pose(half.side, half.pixel)
        if by_pose is not None:
            return by_pose
        near = self._by_clicks(half.side, half.pixel)
        here, there = self._grey(half.side), self._looks_of(other)
        if here is not None and there is not None:
            found = picking.alike(picking.look_at(here, half.pixel), there, near)
            if found is not None:
                u, v = there.uv[found]
                return Expected(other, (float(u), float(v)), "it looks alike: compare")
        if near is not None:
            return Expected(other, self._inside(other, near), "by the points clicked so far")
        return None

    def clicked_already(self, pixel_i: PixelUV, pixel_j: PixelUV) -> bool:
        """Whether a correspondence of the pair is near to these pixels in both images."""
        return any(
            np.hypot(*np.subtract(entry.pick.pixel_i, pixel_i)) < _SAME_PX
            and np.hypot(*np.subtract(entry.pick.pixel_j, pixel_j)) < _SAME_PX
            for entry in self._session.entries()
            if entry.status != "rejected"
        )

    # ---- inside ----------------------------------------------------------------------------------

    def _by_pose(self, side: int, pixel: PixelUV) -> Expected | None:
        here, there = self._depths(side), self._depths(1 - side)
        if here is None or there is None:
            return None
        T_there_here = self._relation(here, there)
        if T_there_here is None:
            return None
        ray = np.linalg.inv(here.camera.K) @ (*pixel, 1.0)

        def seen_at(z: float) -> PixelUV | None:
            point = T_there_here[:3, :3] @ (z * ray) + T_there_here[:3, 3]
            return picking.projected(point, there.camera.K)

        point = here.lift(pixel)
        if point is not None:
            there_px = seen_at(float(point[2]))
            if there_px is None or not _is_inside(there_px, there):
                return None
            return Expected(1 - side, there_px, "by the poses found so far")
        near, far = (seen_at(z) for z in here.depth_range())
        if near is None or far is None:
            return None
        middle = ((near[0] + far[0]) / 2, (near[1] + far[1]) / 2)
        segment = (near, far)
        how = "on this line, by the poses found so far"
        return Expected(1 - side, self._inside(1 - side, middle), how, segment)

    def _relation(self, here: Depths, there: Depths) -> Floats | None:
        """T_there_here of both cameras: by the robots' poses if they are in one component, else by
        the pair's alignment if it may be right.
        """
        poses = self._session.poses()
        a, b = poses.get(here.view.robot), poses.get(there.view.robot)
        if a is not None and b is not None and a.component == b.component:
            T_fleet_here = a.T_fleet_robot @ here.camera.T_robot_camera
            T_fleet_there = b.T_fleet_robot @ there.camera.T_robot_camera
            return np.linalg.inv(T_fleet_there) @ T_fleet_here
        alignment = self._session.alignment
        if alignment is None or alignment.T_i_j is None or alignment.verdict == "rejected":
            return None
        forward = alignment.view_i.robot == there.view.robot
        return alignment.T_i_j if forward else np.linalg.inv(alignment.T_i_j)

    def _by_clicks(self, side: int, pixel: PixelUV) -> PixelUV | None:
        picks = [
            entry.pick
            for entry in self._session.entries()
            if entry.status not in ("rejected", "outlier", "erasing")
        ]
        both = ([p.pixel_i for p in picks], [p.pixel_j for p in picks])
        return picking.mapped(pixel, both[side], both[1 - side])

    def _depths(self, side: int) -> Depths | None:
        pair = self._session.pair
        return self._session.depths(pair[side]) if pair else None

    def _grey(self, side: int) -> Image | None:
        pair = self._session.pair
        picture = self._session.picture(pair[side]) if pair else None
        if picture is None:
            return None
        try:
            return self._greys.of(picture)
        except PictureError:  # the panel says so
            return None

    def _looks_of(self, side: int) -> picking.Looks | None:
        pair = self._session.pair
        picture = self._session.picture(pair[side]) if pair else None
        grey = self._grey(side)
        if picture is None or grey is None:
            return None
        if picture.view not in self._looks:
            recent = list(self._looks.items())[1 - _LOOKS_KEPT :]
            self._looks = dict(recent) | {picture.view: picking.looks_of(grey)}
        return self._looks[picture.view]

    def _inside(self, side: int, pixel: PixelUV) -> PixelUV:
        grey = self._grey(side)
        if grey is None:
            return pixel
        u, v = np.clip(pixel, 0.0, (grey.shape[1] - 1.0, grey.shape[0] - 1.0))
        return float(u), float(v)


def _is_inside(pixel: PixelUV, depths: Depths) -> bool:
    camera = depths.camera
    return 0 <= pixel[0] <= camera.width - 1 and 0 <= pixel[1] <= camera.height - 1
