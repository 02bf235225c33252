"""One message of every class with stated values: for round trips, and for the golden files.

The compressed blocks are written out: another version of the compressor may give other bytes, and
golden files must not change with it.
"""

import numpy as np

from fleetpose.protocol import messages as m

EPOCH = "0123456789ab"
T = np.eye(4)
T[:3, 3] = (1.0, -2.0, 0.5)
COVARIANCE = np.diag([1e-4, 1e-4, 1e-4, 1e-2, 1e-2, 1e-2])
PIXEL = np.array([12.5, 8.25])
V1 = m.ViewName(robot="r1", epoch=EPOCH, seq=12)
V2 = m.ViewName(robot="r2", epoch=EPOCH, seq=2**62)
NOISE = m.NoiseModel.stereo(500.0, 0.1, 0.5, 0.7)
CAMERA = m.Camera(
    width=64,
    height=48,
    K=np.array([[60.0, 0.0, 32.0], [0.0, 60.0, 24.0], [0.0, 0.0, 1.0]]),
    T_robot_camera=m.ROBOT_FROM_CAMERA,
    noise=NOISE,
    kind="stereo",
)
DEPTH_M = np.pad(1.5 + np.arange(15).reshape(3, 5) / 1000, ((1, 0), (1, 0)))
"""(4, 6) metres, 0 where there is no depth: what `DEPTH` holds."""
DEPTH = m.DepthCloud(
    width=6,
    height=4,
    scale=8,
    coding="depth",
    step=0.001,
    data=bytes.fromhex(
        "28b52ffd2030f50000980000b8babcbec0000a0a0a0a0a0b0b0b0b0b000400c0141820257d0bb0"
    ),
)
SCATTERED_UVZ = np.array([[10.0, 20.0, 1.0], [30.5, 21.25, 2.0], [12.0, 40.0, 1.5]])
"""Pixel and depth of the points in `SCATTERED`."""
SCATTERED = m.ScatteredCloud(
    count=3,
    pixel_step_px=1 / 64,
    depth_step_m=0.01,
    data=bytes.fromhex("28b52ffd2024b500008000403f00a060c8c863050a090a000900010068b004"),
)
SALIENT = m.Salient(
    extractor="rootsift",
    count=2,
    descriptor_bytes=8,
    data=bytes.fromhex(
        "28b52ffd2030810100000028410000a2410000003f0ad7233c0000f041000020420000c07f0000c07f"
        "000102030405060708090a0b0c0d0e0f"
    ),
)
"""(10.5, 20.25) with inverse depth 0.5 +- 0.01 and (30, 40) without; descriptors 0..7, 8..15."""
DENIAL = m.Denial(who="robot/r2", what="put", key="fleet/demo/robot/r1/cloud", n=5)
VIEW = m.View(
    name=V1,
    stamp_ns=1,
    camera=CAMERA,
    cloud=SCATTERED,
    salient=SALIENT,
    up_camera=np.array([0.0, -1.0, 0.0]),
    up_sigma_rad=0.01,
    frozen_s=2.5,
    on_way_s=0.5,
    share=0.75,
)
BARE = {"frozen_s": 0.0, "on_way_s": 0.0, "share": 1.0}
HEADER = m.ImageHeader(view=V1, stamp_ns=1, scale=2)
POSE = m.RobotPose(
    robot="r1",
    view=V1,
    stamp_ns=1,
    T_fleet_robot=T,
    covariance=COVARIANCE,
    component="r1",
    located=True,
    verdict="verified",
    gauge_revision=3,
    jumped=False,
    age_s=0.2,
    valid_until_ns=5_000_000_000,
    errors=(m.PairError(other="r2", rmse_m=0.02, verdict="plausible"),),
    server_epoch=EPOCH,
    n=7,
    why_not="its position is known to 8 % of the depth, need 5 %",
)
CORRESPONDENCE = m.Correspondence(
    id=4,
    operator="op",
    view_i=V1,
    view_j=V2,
    pixel_i=PIXEL,
    pixel_j=PIXEL,
    status="accepted",
    residual_m=0.01,
    residual_px=0.8,
    revision=2,
)
CELL = m.PairCell(
    i="r1", j="r2", state="tried", verdict="rejected", rmse_m=0.5, p_grave=0.25, rivals=2
)
SUGGESTION = m.Suggestion(pixel_i=PIXEL, pixel_j=np.array([30.0, 8.5]))
QUESTION = m.Question(
    i="r1",
    j="r2",
    view_i=V1,
    view_j=V2,
    reason="joins two parts",
    gain=0.4,
    suggestions=(SUGGESTION,),
)
ANSWER = m.Answer(
    i="r1", j="r2", clicks=3, predicted=0.4, realised=0.5, joined=("r2",), text="joined r2"
)
ROBOT_STATE = m.RobotState(
    robot="r1", alive=True, newest_view=V1, views_kept=3, pose=POSE, why_not=""
)
ALARM = m.Alarm(robot="r1", kind="scale", text="r1's depths are 5 % too long")

OPERATOR_FIT = m.OperatorFit(
    T_j_i_operator=T, T_j_i_refine=np.eye(4), model="rigid", correspondences=(3, 4, 7)
)
ICP_FIT = m.IcpFit(
    method="point_to_point", error_m2=0.4, rms_m=0.02, count=1000, ms=3.5, kept=False
)
EXAMPLES = {
    type(message): message
    for message in (
        V1,
        NOISE,
        CAMERA,
        m.CameraAnnouncement(
            robot="r1",
            epoch=EPOCH,
            camera=CAMERA,
            rate_hz=1.0,
            capabilities=("image",),
            version="0.1.0",
            clock="recorded",
        ),
        m.Heard(
            robot="r1",
            epoch=EPOCH,
            seq=12,
            waited_s=0.25,
            drops={"not msgpack": 2},
            version="0.1.0",
            reads=("fleet.view.v2", "fleet.view.v3"),
            server_epoch=EPOCH,
            n=7,
        ),
        DENIAL,
        m.Denials(router="a", epoch=EPOCH, denied=(DENIAL,), refused={"Expired": 3}),
        DEPTH,
        SCATTERED,
        SALIENT,
        VIEW,
        HEADER,
        m.KeptView(view=VIEW.model_copy(update=BARE), jpeg=b"\xff\xd8", image=HEADER),
        m.Odometry(robot="r1", epoch=EPOCH, stamp_ns=1, T_odom_robot=T, covariance=COVARIANCE),
        m.PairError(other="r2", rmse_m=0.1, verdict="ambiguous"),
        POSE,
        OPERATOR_FIT,
        ICP_FIT,
        m.Alignment(
            view_i=V1,
            view_j=V2,
            T_i_j=T,
            covariance=COVARIANCE,
            information=np.diag([1e4, 1e4, 1e4, 1e2, 1e2, 1e2]),
            verdict="verified",
            reasons=("many",),
            regression_error_m2=0.3,
            regression_count=40,
            rmse_m=0.02,
            overlap=0.6,
            inliers=50,
            start="features",
            timings_ms={"match": 3.5},
            p_grave=0.004,
            rivals=(T,),
            operator=OPERATOR_FIT,
            icp=ICP_FIT,
            server_epoch=EPOCH,
            n=1,
        ),
        CORRESPONDENCE,
        m.PairCorrespondences(
            i="r1", j="r2", revision=3, items=(CORRESPONDENCE,), server_epoch=EPOCH
        ),
        m.OperatorUpdate(
            operator="op",
            session=EPOCH,
            n=1,
            action="add",
            i="r1",
            j="r2",
            base_revision=0,
            view_i=V1,
            view_j=V2,
            pixel_i=PIXEL,
            pixel_j=PIXEL,
        ),
        m.Rejection(n=3, reason="no depth there"),
        m.Receipts(
            operator="op",
            session=EPOCH,
            n=3,
            rejections=(m.Rejection(n=3, reason="no depth there"),),
            server_epoch=EPOCH,
        ),
        m.Selection(operator="op", session=EPOCH, i="r1", j="r2", view_i=V1, view_j=V2),
        CELL,
        SUGGESTION,
        QUESTION,
        ANSWER,
        ROBOT_STATE,
        ALARM,
        m.FleetState(
            server_epoch=EPOCH,
            n=9,
            stamp_ns=1,
            anchor="r1",
            gauge_revision=1,
            up_assumed=True,
            robots=(ROBOT_STATE,),
            pairs=(CELL,),
            questions=(QUESTION,),
            events=("r1 joined",),
            pinned=(V1,),
            alarms=(ALARM,),
            answered=(ANSWER,),
            depth_m=6.5,
        ),
        m.ServerStatus(
            server_epoch=EPOCH,
            uptime_s=1.0,
            views=1,
            alignments=2,
            solves=3,
            pending_jobs=0,
            workers=2,
            pairs_per_s=4.0,
            other_cpu_ms_per_view=8.0,
            max_pair_wait_s=2.0,
            drops={"codec": 1},
            version="0.1.0",
            waiting={"joining": 3},
            wait_share=0.25,
            denied=(DENIAL,),
            refused={"Expired": 3},
            stage_ms={"solve": 5.5},
            picked="r1 - r2: may join two components",
        ),
        m.RelativePose(
            a="r1",
            b="r2",
            T_a_b=T,
            covariance=COVARIANCE,
            age_s=0.1,
            through=("r3",),
            verdict="plausible",
            located=True,
            p_grave=0.125,
            why_not="r2: its newest view is 7 s old",
        ),
        m.WhyNot(
            robot="r1",
            located=False,
            why_not="its token is gone",
            alarms=("r1's depths are 5 % too long",),
        ),
    )
}
