"""What papers report, to be printed beside one's own run: absolute trajectory errors, metres.

Read in the papers' own tables unless `second_hand`: those are from summaries and to be checked
before they are quoted. Other sensors than ours are named: a lidar or an IMU makes another problem.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class Reported:
    """One number of a table.

    Attributes:
        sequences: robots or sequences that ran together.
        sensor: what the method had.
        second_hand: taken from a summary, not from the paper.
    """

    sequences: str
    method: str
    ate_m: float
    sensor: str
    source: str
    second_hand: bool = False


NOT_TOLD = "not told"  # by the sources that were read
_COVINS = "COVINS, ISMAR 2021, Table 1"
_SWARM = "Swarm-SLAM, RA-L 2024, Table II"
_DCL = "DCL-SLAM, Table II"
_ISSUE = "MultiSlam_DiffPose, issue 3"


def _covins(method: str, *ate_m: float | None) -> tuple[Reported, ...]:
    sequences = ("MH01-03", "MH01-05", "V101-103")
    return tuple(
        Reported(names, method, value, NOT_TOLD, _COVINS)
        for names, value in zip(sequences, ate_m, strict=True)
        if value is not None
    )


REPORTED: dict[str, tuple[Reported, ...]] = {
    "euroc": (
        *_covins("COVINS", 0.024, 0.036, 0.042),
        *_covins("ORB-SLAM3", 0.041, 0.082, 0.048),
        *_covins("VINS-mono", 0.062, 0.100, 0.076),
        *_covins("CVI-SLAM", 0.054, 0.091, None),
        Reported("MH01-03", "CCM-SLAM", 0.077, NOT_TOLD, "JFR 2019", True),
        Reported("MH01-03", "MultiSlam", 0.022, NOT_TOLD, _ISSUE),
        Reported("MH01-05", "MultiSlam", 0.036, NOT_TOLD, _ISSUE),
        Reported("V101-103", "MultiSlam", 0.031, NOT_TOLD, _ISSUE),
        Reported("V201-203", "MultiSlam", 0.024, NOT_TOLD, _ISSUE),
        Reported("MH01-03", "MultiSlam, by a user", 0.045, NOT_TOLD, _ISSUE),
        Reported("MH01-05", "MultiSlam, by a user", 0.059, NOT_TOLD, _ISSUE),
        Reported("V101-103", "MultiSlam, by a user", 0.081, NOT_TOLD, _ISSUE),
        Reported("V201-203", "MultiSlam, by a user", 0.072, NOT_TOLD, _ISSUE),
        Reported("MH, 5 robots", "Kimera-Multi", 0.41, NOT_TOLD, "T-RO 2022, Table I", True),
        Reported("MH, 5 robots", "PCM", 1.76, NOT_TOLD, "T-RO 2022, Table I", True),
        Reported("MH, 5 robots", "centralised", 0.52, NOT_TOLD, "T-RO 2022, Table I", True),
    ),
    "kitti": (
        Reported("00, 2 robots", "Swarm-SLAM", 2.17, "lidar or stereo", _SWARM),
        Reported("360 09, 5 robots", "Swarm-SLAM", 4.02, "lidar or stereo", _SWARM),
    ),
    "tum": (),
    "7scenes": (),
    "replica": (
        Reported("ReplicaMultiagent", "MAGiC-SLAM", 0.0027, "RGB-D", "CVPR 2025", True),
        Reported("ReplicaMultiagent", "CP-SLAM", 0.0065, "RGB-D", "CVPR 2025", True),
        Reported("AriaMultiagent", "MAGiC-SLAM", 0.0090, "RGB-D", "CVPR 2025", True),
    ),
    "s3e": (
        Reported("Square", "Swarm-SLAM", 4.20, "lidar or stereo", _SWARM),
        Reported("College", "Swarm-SLAM", 3.57, "lidar or stereo", _SWARM),
        *(
            Reported(f"Library, robot {k}", method, value, "lidar", _DCL)
            for method, values in (
                ("Swarm-SLAM", (1.31, 1.59, 1.16)),
                ("DCL-LIO-SAM", (0.58, 1.26, 1.17)),
            )
            for k, value in enumerate(values, 1)
        ),
    ),
    "kimera-multi": tuple(
        Reported("outdoor", method, value, NOT_TOLD, "GRAND-SLAM, RA-L 2025", True)
        for method, value in (("GRAND-SLAM", 4.99), ("ORB-SLAM3", 10.58), ("MAGiC-SLAM", 60.8))
    ),
    "graco": (Reported("3 robots", "Swarm-SLAM", 6.19, "lidar or stereo", _SWARM),),
}
