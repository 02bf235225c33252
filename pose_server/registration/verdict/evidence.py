"""All that speaks for and against a found pose."""

from dataclasses import dataclass

from fleetpose.pose_server.registration.verdict.explained import Explained

NO_RIVAL = 30.0  # numerical: log odds beyond which nothing changes


@dataclass(frozen=True)
class Evidence:
    """What speaks for and against a pose. Shares are of the median depth.

    Attributes:
        inliers: guided and ratio matches at distinct places that agree with the pose.
        ratio_inliers: of these, the ones found by descriptor alone.
        ratio_matches: matches found by descriptor alone.
        exact: of the inliers, the ones that lie as near to the epipolar line as the cameras' noise
            lets them.
        rival: ratio matches that agree with the best other pose, and not with this one.
        rivalled: ratio matches that agree with this pose, and not with that one.
        position_sigma: calibrated sigma of the weakest direction of the position, share.
        rotation_sigma_rad: calibrated sigma of the weakest rotation.
        across_px: sigma of the residuals across the epipolar lines.
        pixel_sigma_px: what it should be by the cameras' noise.
        shift: how far a refit on the matches moves the position that they led to, share.
        turn_rad: how far it turns.
        pulled: how far surfaces have moved that position, share.
        compared: points compared with the other surface.
        agree: share of these that agree in depth.
        through: share of these that the other view sees through.
        spread: smaller extent of the matches in the images, share of the image height.
        depth_noise: depth noise found over depth noise stated.
        depth_sigma: relative sigma of the distance of two matching points along the ray, stated.
        lead: by how many sigmas it finds more again than the best pose that the place's repetitions
            offer; `NO_RIVAL` where they offer none.
        explained: what should be seen from there and is found again.
    """

    inliers: int
    exact: int
    ratio_inliers: int
    ratio_matches: int
    rival: int
    rivalled: int
    position_sigma: float
    rotation_sigma_rad: float
    across_px: float
    pixel_sigma_px: float
    shift: float
    turn_rad: float
    pulled: float
    compared: int
    agree: float
    through: float
    spread: float
    depth_noise: float
    depth_sigma: float
    lead: float
    explained: Explained


@dataclass(frozen=True)
class SurfaceEvidence:
    """What speaks for and against a pose by clouds alone.

    Attributes:
        compared, agree, through, overlap: see `geometry.evidence.Agreement`.
        score: what agrees beyond what is seen through, times the root of the overlap.
        rival: the largest score of a pose elsewhere.
        position_sigma: of the weakest direction, share of the median depth.
        rotation_sigma_rad: of the weakest rotation.
    """

    compared: int
    agree: float
    through: float
    overlap: float
    score: float
    rival: float
    position_sigma: float
    rotation_sigma_rad: float
