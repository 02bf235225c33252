"""`sensor_msgs/PointCloud2` as arrays."""

from typing import Any

import numpy as np
import numpy.typing as npt

from fleetpose.protocol.errors import CodecError

_KINDS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}


def xyz_of(message: Any) -> npt.NDArray[np.float64]:
    """(H, W, 3) metres in the cloud's own frame, nan where there is no point; H = 1 of a cloud that
    is not organised.

    Raises:
        CodecError: it has no x, y and z, or is shorter than its size asks for.
    """
    height, width = int(message.height), int(message.width)
    step, row = int(message.point_step), int(message.row_step)
    fields = {field.name: field for field in message.fields}
    if any(name not in fields for name in "xyz"):
        raise CodecError(f"a cloud without x, y and z: it has {', '.join(fields) or 'nothing'}")
    order = ">" if message.is_bigendian else "<"
    kinds = [_kind(fields[name], order) for name in "xyz"]
    offsets = [int(fields[name].offset) for name in "xyz"]
    ends = [offset + kind.itemsize for offset, kind in zip(offsets, kinds, strict=True)]
    data = np.asarray(message.data, np.uint8)
    if max(ends) > step or row < width * step or data.size < height * row:
        raise CodecError(
            f"a cloud {width}x{height} of {step} bytes a point and {data.size} bytes in all"
        )
    rows = data[: height * row].reshape(height, row)[:, : width * step]
    point = np.dtype({"names": list("xyz"), "formats": kinds, "offsets": offsets, "itemsize": step})
    points = np.ascontiguousarray(rows).view(point).reshape(height, width)
    return np.stack([points[name].astype(np.float64) for name in "xyz"], axis=-1)


def _kind(field: Any, order: str) -> "np.dtype[Any]":
    if int(field.datatype) not in _KINDS:
        raise CodecError(f"a cloud whose {field.name} is of the unknown type {field.datatype}")
    return np.dtype(_KINDS[int(field.datatype)]).newbyteorder(order)
