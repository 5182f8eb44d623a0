"""ROS's sensor_msgs_py.point_cloud2: the points of a PointCloud2 as arrays, and back."""

import sys
from collections import namedtuple
from collections.abc import Iterable
from typing import Any

from tfbus.base import lazy_numpy as np
from tfbus.ros.message_classes import message_class

__all__ = [
    "create_cloud",
    "create_cloud_xyz32",
    "dtype_from_fields",
    "read_points",
    "read_points_list",
    "read_points_numpy",
]

_PointCloud2: Any = message_class("sensor_msgs/msg/PointCloud2")
_PointField: Any = message_class("sensor_msgs/msg/PointField")

# numpy's types by the numbers of PointField.
_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}


def dtype_from_fields(fields: Iterable[Any], point_step: int | None = None) -> Any:
    """numpy's type of a point with these fields."""
    return _dtype(fields, point_step, "=")


def read_points(
    cloud: Any,
    field_names: list[str] | None = None,
    skip_nans: bool = False,
    uvs: Any = None,
    reshape_organized_cloud: bool = False,
) -> Any:
    """The points as a structured array (N,), with all of `cloud.fields` or the named ones.

    `skip_nans` leaves out points with one; `uvs` are indices of points, or pairs of column and row;
    `reshape_organized_cloud` gives (height, width).
    """
    order = ">" if cloud.is_bigendian else "<"
    dtype = _dtype(cloud.fields, cloud.point_step, order)
    data = np.frombuffer(bytes(cloud.data), np.uint8)
    row = cloud.width * cloud.point_step
    if cloud.height > 1 and cloud.row_step > row:  # each row is filled up
        data = data[: cloud.height * cloud.row_step].reshape(cloud.height, -1)[:, :row]
    points = np.ascontiguousarray(data).reshape(-1)[: cloud.height * row].view(dtype)
    if field_names is not None:
        missing = {*field_names} - {*(points.dtype.names or ())}
        if missing:
            raise AssertionError(
                f"the cloud has no field {', '.join(sorted(missing))}: it has "
                f"{', '.join(points.dtype.names or ())}"
            )
        points = points[list(field_names)]
    if uvs is not None:
        points = points[_indices(uvs, cloud)]
    if skip_nans:
        is_whole = np.ones(len(points), bool)
        for name in points.dtype.names or ():
            values = points[name].reshape(len(points), -1)
            is_whole &= ~np.isnan(values).any(axis=1)
        points = points[is_whole]
    if reshape_organized_cloud and cloud.height > 1:
        points = points.reshape(cloud.height, cloud.width)
    if (sys.byteorder == "big") != bool(cloud.is_bigendian):
        points = points.astype(points.dtype.newbyteorder("="))
    return points


def read_points_numpy(
    cloud: Any,
    field_names: list[str] | None = None,
    skip_nans: bool = False,
    uvs: Any = None,
    reshape_organized_cloud: bool = False,
) -> Any:
    """The points as an array (N, fields) of one type. Raises AssertionError if the fields have
    several types.
    """
    points = read_points(cloud, field_names, skip_nans, uvs, reshape_organized_cloud)
    kinds = {points.dtype[name] for name in points.dtype.names or ()}
    if len(kinds) != 1:
        raise AssertionError("the fields must be of one type: read_points takes several")
    columns = [points[name] for name in points.dtype.names or ()]
    return np.stack(columns, axis=-1)


def read_points_list(
    cloud: Any, field_names: list[str] | None = None, skip_nans: bool = False, uvs: Any = None
) -> list[Any]:
    """The points as a list of named tuples."""
    points = read_points(cloud, field_names, skip_nans, uvs)
    point: Any = namedtuple("Point", list(points.dtype.names or ()))  # type: ignore[misc]
    return [point._make(each) for each in points.tolist()]


def create_cloud(header: Any, fields: Iterable[Any], points: Any, step: int | None = None) -> Any:
    """A PointCloud2 of points: a structured array, or rows of numbers in the fields' order."""
    fields = list(fields)
    dtype = _dtype(fields, step, "<")
    if not (isinstance(points, np.ndarray) and points.dtype.names):
        rows = np.array([tuple(row) for row in points], dtype=dtype)
        if isinstance(points, np.ndarray) and points.ndim == 3:
            flat = points.reshape(-1, points.shape[-1])
            rows = np.array([tuple(row) for row in flat], dtype=dtype).reshape(points.shape[:2])
    else:
        rows = np.zeros(points.shape, dtype)
        for name in points.dtype.names:
            rows[name] = points[name]
    height, width = rows.shape if rows.ndim == 2 else (1, len(rows))
    return _PointCloud2(
        header=header,
        height=height,
        width=width,
        is_bigendian=False,
        is_dense=False,
        fields=fields,
        point_step=dtype.itemsize,
        row_step=dtype.itemsize * width,
        data=rows.tobytes(),
    )


def create_cloud_xyz32(header: Any, points: Any, step: int | None = None) -> Any:
    """A PointCloud2 of rows x, y, z."""
    fields = [
        _PointField(name=name, offset=4 * at, datatype=_PointField.FLOAT32, count=1)
        for at, name in enumerate("xyz")
    ]
    return create_cloud(header, fields, points, step)


def _dtype(fields: Iterable[Any], point_step: int | None, order: str) -> Any:
    names, formats, offsets = [], [], []
    for at, field in enumerate(fields):
        names.append(field.name or f"unnamed_field_{at}")
        kind = np.dtype(order + _TYPES[field.datatype])
        formats.append((kind, (field.count,)) if field.count > 1 else kind)
        offsets.append(field.offset)
    wanted: Any = {"names": names, "formats": formats, "offsets": offsets}
    if point_step is not None:
        wanted["itemsize"] = point_step
    return np.dtype(wanted)


def _indices(uvs: Any, cloud: Any) -> Any:
    given = np.asarray(uvs, int)
    return given if given.ndim == 1 else given[:, 1] * cloud.width + given[:, 0]
