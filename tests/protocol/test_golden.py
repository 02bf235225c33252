"""Bytes of every released version are read as what they meant; the newest are written the same."""

import numpy as np
import pytest

from fleetpose.protocol import clouds, codec
from fleetpose.protocol import messages as m
from fleetpose.protocol.errors import CodecError
from tests.protocol import golden
from tests.protocol.message_examples import DEPTH_M, EXAMPLES, SCATTERED_UVZ

BARE_CELL = {"p_grave": None, "rivals": 0}
BARE_POSE = EXAMPLES[m.RobotPose].model_dump() | {"why_not": ""}
ADDED = {
    "fleet.alignment.v2": {"operator": None, "icp": None},
    "fleet.pose.v1": {"why_not": ""},
    "fleet.robot_state.v1": {"pose": BARE_POSE},
    "fleet.pair_cell.v1": BARE_CELL,
    "fleet.state.v6": {"depth_m": None},
    "fleet.relative_pose.v1": {
        "verdict": "ambiguous",
        "located": False,
        "p_grave": None,
        "why_not": "",
    },
    "fleet.question.v1": {"suggestions": ()},
    "fleet.view.v2": {"on_way_s": 0.0, "share": 1.0},
    "fleet.camera_announcement.v2": {"clock": "live"},
    "fleet.status.v2": {"denied": (), "refused": {}},
}
"""What the reader puts where an earlier version had no field yet."""
READ = [(c, c.schema_name) for c in m.MESSAGES] + [
    (c, c.schema_before) for c in m.MESSAGES if c.schema_before is not None
]
versions = pytest.mark.parametrize(("message_class", "schema"), READ, ids=[n for _, n in READ])


def golden_bytes(schema: str) -> bytes:
    return golden.path_of(schema).read_bytes()


def equal(a: object, b: object) -> bool:
    if isinstance(a, dict) and isinstance(b, dict):
        return a.keys() == b.keys() and all(equal(a[k], b[k]) for k in a)
    if isinstance(a, tuple) and isinstance(b, tuple):
        return len(a) == len(b) and all(map(equal, a, b))
    if isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
        return a.dtype == b.dtype and np.array_equal(a, b)
    return type(a) is type(b) and a == b


def test_every_version_that_is_read_has_its_file_and_no_file_is_left_over():
    assert {path.stem for path in golden.FOLDER.iterdir()} == {schema for _, schema in READ}
    assert not golden.missing()


@versions
def test_golden_bytes_are_read_as_the_stated_values(message_class, schema):
    message = codec.unpack(message_class, golden_bytes(schema), f"application/msgpack;{schema}")
    stated = EXAMPLES[message_class].model_dump() | ADDED.get(schema, {})
    assert equal(message.model_dump(), stated)


@pytest.mark.parametrize("message_class", m.MESSAGES, ids=lambda c: c.schema_name)
def test_the_newest_version_is_written_to_the_same_bytes(message_class):
    written = codec.pack(EXAMPLES[message_class])
    assert written == golden_bytes(message_class.schema_name), (
        "the bytes have changed: give the message a new version, name the one before, and run "
        "python -m tests.protocol.golden"
    )


@versions
def test_no_other_version_is_read(message_class, schema):
    later = schema.rpartition(".")[0] + ".v9"
    with pytest.raises(CodecError, match=r"\.v9"):
        codec.unpack(message_class, golden_bytes(schema), f"application/msgpack;{later}")


def test_golden_blocks_hold_the_stated_points():
    depth = codec.unpack(m.DepthCloud, golden_bytes("fleet.depth_cloud.v1"))
    expected = np.where(DEPTH_M > 0, DEPTH_M, np.nan)
    assert np.allclose(clouds.decode_depth(depth), expected, atol=1e-6, equal_nan=True)
    scattered = codec.unpack(m.ScatteredCloud, golden_bytes("fleet.scattered_cloud.v1"))
    uv, z = clouds.decode_scattered(scattered)
    assert np.allclose(np.column_stack((uv, z)), SCATTERED_UVZ)
    salient = clouds.decode_salient(codec.unpack(m.Salient, golden_bytes("fleet.salient.v1")))
    assert salient.uv.tolist() == [[10.5, 20.25], [30.0, 40.0]]
    assert np.allclose(salient.inverse_depth, [0.5, np.nan], equal_nan=True)
    assert np.allclose(salient.inverse_depth_sigma, [0.01, np.nan], equal_nan=True)
    assert salient.descriptors.tolist() == [list(range(8)), list(range(8, 16))]
