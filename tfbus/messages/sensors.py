"""Messages of sensors: clouds of points, scans, distances, inertial and satellite measurements."""

from dataclasses import dataclass, field
from functools import lru_cache
from math import inf
from typing import Any, ClassVar

from tfbus.base import lazy_numpy as np
from tfbus.base.bounded import MadeOf
from tfbus.base.lazy_numpy import ArrayLike, NDArray
from tfbus.messages.fields import (
    Float32Array,
    UInt8Array,
    WithArrays,
    check_byte,
    check_count,
    check_finite,
    check_one_of,
    check_size,
    check_stamp,
    check_unsigned,
    no_numbers,
)
from tfbus.messages.geometry import Quaternion, Vector3

# More columns than these are refused: no sensor has so many, and to name them takes long.
_MOST_COLUMNS = 1000

# Columns in which drivers write when a point was measured, times after the stamp first. A float is
# in seconds, an integer in nanoseconds.
_TIME_COLUMNS = ("t", "time", "time_offset", "offset_time", "time_stamp", "timestamp", "timestamps")


@dataclass(frozen=True, slots=True)
class PointField:
    """A column of a PointCloud: `count` numbers of the type `datatype`, `offset` bytes from the
    first of each point.
    """

    __msgtype__: ClassVar[str] = "sensor_msgs/msg/PointField"

    INT8: ClassVar[int] = 1
    UINT8: ClassVar[int] = 2
    INT16: ClassVar[int] = 3
    UINT16: ClassVar[int] = 4
    INT32: ClassVar[int] = 5
    UINT32: ClassVar[int] = 6
    FLOAT32: ClassVar[int] = 7
    FLOAT64: ClassVar[int] = 8

    name: str = ""
    offset: int = 0
    datatype: int = 7
    count: int = 1

    def __post_init__(self) -> None:
        check_unsigned("offset", self.offset)
        check_one_of("datatype", self.datatype, _DATATYPES)
        check_unsigned("count", self.count)

    @property
    def kind(self) -> str:
        """The type of its numbers as numpy names it, without the byte order: `f4`."""
        return _KINDS[self.datatype]

    @property
    def size(self) -> int:
        """Its bytes in a point. A count of 0 stands for 1, as some drivers write it."""
        return int(self.kind[1]) * max(self.count, 1)


_KINDS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
_DATATYPE_OF = {kind: datatype for datatype, kind in _KINDS.items()}
_DATATYPES = {
    1: "int8",
    2: "uint8",
    3: "int16",
    4: "uint16",
    5: "int32",
    6: "uint32",
    7: "float32",
    8: "float64",
}


@dataclass(frozen=True, slots=True, eq=False)
class PointCloud(WithArrays):
    """Points in the frame `frame_id` at stamp_ns, each with named columns: ROS's PointCloud2.

    `fields` are the columns of a point, which takes `point_step` bytes of `data`; `height` rows of
    `width` points take `row_step` bytes each. A cloud without order has one row. `is_dense` says
    that no point is NaN. `from_xyz` and `from_array` make one; `xyz` and `as_array` read it.
    """

    __msgtype__: ClassVar[str] = "sensor_msgs/msg/PointCloud2"
    __changes__: ClassVar[str] = "data"

    stamp_ns: int
    frame_id: str
    height: int = 1
    width: int = 0
    fields: tuple[PointField, ...] = ()
    is_bigendian: bool = False
    point_step: int = 0
    row_step: int = 0
    data: UInt8Array = field(default_factory=no_numbers)
    is_dense: bool = False

    def __post_init__(self) -> None:
        check_stamp("stamp_ns", self.stamp_ns)
        check_unsigned("height", self.height)
        check_unsigned("width", self.width)
        check_unsigned("point_step", self.point_step)
        check_unsigned("row_step", self.row_step)
        self._make_arrays()
        if len(self.fields) > _MOST_COLUMNS:
            raise ValueError(f"fields must be at most {_MOST_COLUMNS}, not {len(self.fields)}")
        if self.fields.__class__ is not tuple:
            object.__setattr__(self, "fields", tuple(self.fields))
        self._layout()
        if self.row_step < self.width * self.point_step:
            raise ValueError(
                f"row_step must be at least width times point_step, "
                f"{self.width * self.point_step} bytes, not {self.row_step}"
            )
        if self.height * self.width and not self.point_step:
            raise ValueError("point_step must be at least 1 byte")
        check_size("data", self.data, self.height, self.row_step, of="height times row_step")

    @classmethod
    def from_xyz(
        cls, stamp_ns: int, frame_id: str, xyz: "ArrayLike", **columns: "ArrayLike"
    ) -> "PointCloud":
        """The cloud of points (N, 3) in m, as float32 in columns x, y and z, and further columns,
        each of N numbers or (N, count). Raises ValueError for another shape.
        """
        points = np.asarray(xyz)
        if points.ndim != 2 or points.shape[1] != 3:
            raise ValueError(f"xyz must have the shape (N, 3), not {points.shape}")
        named: dict[str, Any] = dict(
            zip("xyz", points.astype(np.float32, copy=False).T, strict=True)
        )
        named |= {name: np.asarray(column) for name, column in columns.items()}
        dtype = []
        for name, column in named.items():
            if column.ndim not in (1, 2) or len(column) != len(points):
                raise ValueError(
                    f"{name} must have the shape ({len(points)},) or ({len(points)}, count), not "
                    f"{column.shape}"
                )
            dtype.append((name, column.dtype, column.shape[1:]))
        array = np.empty(len(points), dtype)
        for name, column in named.items():
            array[name] = column
        return cls.from_array(stamp_ns, frame_id, array)

    @classmethod
    def from_array(cls, stamp_ns: int, frame_id: str, array: "NDArray[Any]") -> "PointCloud":
        """The cloud of a structured array (N,), or (height, width), with its fields as columns.

        It shares the array's memory, if that is contiguous. Raises ValueError for an array without
        fields, or with one of another type than a PointField has.
        """
        names = array.dtype.names
        if names is None or array.ndim not in (1, 2):
            raise ValueError(
                "array must be a structured one (N,) or (height, width), such as "
                f"np.zeros(n, [('x', 'f4'), ('y', 'f4'), ('z', 'f4')]), not {array.dtype} of the "
                f"shape {array.shape}"
            )
        array = np.ascontiguousarray(array)
        fields = _columns(array.dtype)
        height, width = (1, len(array)) if array.ndim == 1 else array.shape
        step = array.dtype.itemsize
        is_dense = all(bool(np.isfinite(array[name]).all()) for name in names if name in "xyz")
        data = array.reshape(-1).view(np.uint8)
        is_bigendian = np.little_endian is False
        row_step = width * step
        return cls(
            stamp_ns,
            frame_id,
            height,
            width,
            fields,
            is_bigendian,
            step,
            row_step,
            data,
            is_dense,
        )

    def __len__(self) -> int:
        """How many points it has."""
        return self.height * self.width

    def as_array(self) -> "NDArray[Any]":
        """The points as a structured array (height, width), or (N,) if it has one row: a view of
        `data`, which cannot be written to.
        """
        layout = self._layout()
        shape = (self.height, self.width) if self.height != 1 else (self.width,)
        if not len(self):
            return np.empty(shape, layout)
        steps = (self.row_step, self.point_step)[-len(shape) :]
        return np.ndarray(shape, layout, self.data, 0, steps)

    def _layout(self) -> Any:
        how = self.is_bigendian, self.point_step
        known = _layouts.get(self.fields, how)
        if known is None:
            known = _layouts.keep(_layout(self.fields, *how), self.fields, how)
        return known

    def __getitem__(self, name: str) -> "NDArray[Any]":
        """A column (N,) by its name, or (N, count): a view of `data` where its rows have no gaps.

        Raises KeyError for one that it does not have.
        """
        array = self.as_array()
        if name not in (array.dtype.names or ()):
            raise KeyError(
                f"the cloud has no column {name!r}; it has {', '.join(array.dtype.names or ())}"
            )
        column: NDArray[Any] = array[name]
        return column.reshape(len(self), *column.shape[array.ndim :]) if array.ndim > 1 else column

    def __contains__(self, name: object) -> bool:
        """Whether it has a column of this name."""
        return any(each.name == name for each in self.fields)

    def xyz(self) -> "NDArray[np.floating[Any]]":
        """The points (N, 3) in m: float32 or float64 as in the cloud, a view of `data` if x, y and
        z lie one behind the other. Raises KeyError if it lacks one of them.
        """
        columns = [self[name] for name in "xyz"]
        by_name = {each.name: each for each in self.fields}
        x, y, z = (by_name[name] for name in "xyz")
        size = x.size
        is_together = (y.offset - x.offset, z.offset - y.offset) == (size, size)
        if (
            {x.kind, y.kind, z.kind} <= {"f4", "f8"}
            and is_together
            and x.kind == y.kind == z.kind
            and x.count <= 1
            and len(self)
            and self.row_step == self.width * self.point_step
        ):
            order = ">" if self.is_bigendian else "<"
            points: NDArray[Any] = np.ndarray(
                (len(self), 3), f"{order}{x.kind}", self.data, x.offset, (self.point_step, size)
            )
            return points
        kind = np.float64 if "f8" in (x.kind, y.kind, z.kind) else np.float32
        stacked: NDArray[Any] = np.stack(columns, axis=-1).astype(kind, copy=False)
        return stacked.reshape(len(self), 3)

    def stamps_ns(self) -> "NDArray[np.int64] | None":
        """When each point was measured (N,), by a column such as `t` or `time`; None without one.

        Integers are nanoseconds and floats seconds, after the stamp, or since the Unix epoch if
        they are that large. A time that is not finite is that of the stamp.
        """
        name = self.time_column
        if name is None:
            return None
        numbers = np.asarray(self[name])
        unit_ns, is_since_epoch = _unit(numbers)
        start_ns = 0 if is_since_epoch else self.stamp_ns
        if numbers.dtype.kind in "iu":
            return numbers.astype(np.int64) + start_ns
        is_known = np.isfinite(numbers)
        finite = np.where(is_known, numbers, 0.0).astype(np.float64)
        finite = np.clip(finite, -(2.0**62) / unit_ns, 2.0**62 / unit_ns)
        whole = np.floor(finite)
        ns = whole.astype(np.int64) * unit_ns + np.rint((finite - whole) * unit_ns).astype(np.int64)
        return np.where(is_known, ns + start_ns, self.stamp_ns)

    def at_stamp(self, array: "NDArray[Any]") -> None:
        """Write into the columns of a copy that each point is as it was at the stamp."""
        name = self.time_column
        if name is not None:
            unit_ns, is_since_epoch = _unit(self[name])
            array[name] = self.stamp_ns / unit_ns if is_since_epoch else 0

    @property
    def time_column(self) -> str | None:
        """The name of the column that says when each point was measured; None without one."""
        names = [each.name for each in self.fields if each.count <= 1]
        return next((name for name in _TIME_COLUMNS if name in names), None)


def _unit(times: "NDArray[Any]") -> tuple[int, bool]:
    """How many nanoseconds a one of these times is, and whether they are since the Unix epoch."""
    if times.dtype.kind in "iu":
        return 1, False  # 32 bits hold no time since the epoch
    known = times[np.isfinite(times)].astype(np.float64)
    largest = float(np.max(np.abs(known), initial=0.0))
    return (1, True) if largest >= _EPOCH_NS else (1_000_000_000, largest >= _EPOCH_S)


# Larger numbers are times since the epoch, in nanoseconds or seconds, and not since the stamp.
_EPOCH_NS = 3e17
_EPOCH_S = 3e8


@lru_cache(64)
def _columns(dtype: Any) -> tuple[PointField, ...]:
    """The columns of a structured array. Raises ValueError for one that a cloud cannot have."""
    fields, orders = [], set()
    for name in dtype.names:
        of_column, offset = dtype.fields[name][:2]
        base = of_column.base
        kind = f"{base.kind}{base.itemsize}"
        if kind not in _DATATYPE_OF:
            raise ValueError(
                f"column {name!r} must be {', '.join(_DATATYPES.values())}, not {base}"
            )
        count = int(np.prod(of_column.shape, dtype=int))
        fields.append(PointField(name, int(offset), _DATATYPE_OF[kind], count))
        orders.add(base.newbyteorder("=").str[0] == base.str[0] or base.itemsize == 1)
    if orders != {True}:
        raise ValueError("the numbers of all columns must have this machine's byte order")
    return tuple(fields)


_layouts: MadeOf[Any] = MadeOf(64)


def _layout(fields: tuple[PointField, ...], is_bigendian: bool, point_step: int) -> Any:
    """The structured dtype of a point. Raises ValueError for two columns of one name, and for one
    that does not end within the point.
    """
    for each in fields:
        if each.offset + each.size > point_step:
            raise ValueError(
                f"the column {each.name[:60]!r} must end within point_step, {point_step} bytes, "
                f"not at {each.offset + each.size}"
            )

    order = ">" if is_bigendian else "<"
    names = [each.name or f"unnamed_field_{at}" for at, each in enumerate(fields)]
    if len(set(names)) != len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"the column {twice[:60]!r} must be in fields once, not twice")
    formats = [
        f"{order}{each.kind}" if each.count <= 1 else (f"{order}{each.kind}", (each.count,))
        for each in fields
    ]
    offsets = [each.offset for each in fields]
    if not names and not point_step:
        return np.dtype([])
    return np.dtype(
        {"names": names, "formats": formats, "offsets": offsets, "itemsize": point_step}
    )


@dataclass(frozen=True, slots=True, eq=False)
class LaserScan(WithArrays):
    """A turn of a planar laser scanner, in the frame `frame_id` of the sensor.

    `ranges` in m are at the angles angle_min + i * angle_increment, in rad about z from x; stamp_ns
    is when the first was measured, and `time_increment` how many seconds pass between two. A range
    below range_min, of range_max or more, of 0, infinite or NaN is no measurement. `intensities`
    are as many, in units of the device, or none. `scan_time` is the time between two scans in s.
    """

    __msgtype__: ClassVar[str] = "sensor_msgs/msg/LaserScan"

    stamp_ns: int
    frame_id: str
    angle_min: float = 0.0
    angle_max: float = 0.0
    angle_increment: float = 0.0
    time_increment: float = 0.0
    scan_time: float = 0.0
    range_min: float = 0.0
    range_max: float = inf
    ranges: Float32Array = field(default_factory=no_numbers)
    intensities: Float32Array = field(default_factory=no_numbers)

    def __post_init__(self) -> None:
        check_stamp("stamp_ns", self.stamp_ns)
        for name in ("angle_min", "angle_max", "angle_increment", "time_increment", "scan_time"):
            check_finite(name, getattr(self, name))
        self._make_arrays()
        if len(self.intensities):
            check_size("intensities", self.intensities, len(self.ranges), of="or none, as ranges")

    def angles(self) -> "NDArray[np.float64]":
        """The angle of each range (N,), in rad."""
        return self.angle_min + self.angle_increment * np.arange(len(self.ranges), dtype=np.float64)

    def xyz(self) -> "NDArray[np.float64]":
        """The points (N, 3) in m in the frame of the sensor, NaN where there is no measurement."""
        angles = self.angles()
        # Drivers write range_max, which RViz leaves out too, or 0 for nothing seen. In the 32 bits
        # of the ranges, or one of 29.9 m would be below a range_max of that.
        with np.errstate(invalid="ignore", over="ignore"):
            least, most = np.float32(self.range_min), np.float32(self.range_max)
            is_measured = (self.ranges >= least) & (self.ranges < most) & (self.ranges > 0.0)
        ranges = np.where(is_measured, self.ranges.astype(np.float64), np.nan)
        xyz = np.zeros((len(ranges), 3))
        xyz[:, 0] = ranges * np.cos(angles)
        xyz[:, 1] = ranges * np.sin(angles)
        xyz[:, 2] = ranges * 0.0
        return xyz

    def cloud(self) -> PointCloud:
        """The points as a cloud of the same frame and stamp, with the column `intensity` if there
        are intensities; NaN where there is no measurement.
        """
        columns = {"intensity": self.intensities} if len(self.intensities) else {}
        return PointCloud.from_xyz(self.stamp_ns, self.frame_id, self.xyz(), **columns)

    def stamps_ns(self) -> "NDArray[np.int64]":
        """When each range was measured (N,)."""
        after_ns = np.rint(self.time_increment * 1e9 * np.arange(len(self.ranges)))
        stamps_ns: NDArray[np.int64] = after_ns.astype(np.int64) + self.stamp_ns
        return stamps_ns


@dataclass(frozen=True, slots=True)
class Range:
    """A distance measured along x of the frame `frame_id`, by ultrasound or infrared.

    `range` in m is infinite if nothing is near enough, -infinite if something is too near, and NaN
    for no measurement; `field_of_view` is the angle of the cone in rad, and `variance` in m² is 0
    where it is not known.
    """

    ULTRASOUND: ClassVar[int] = 0
    INFRARED: ClassVar[int] = 1

    __msgtype__: ClassVar[str] = "sensor_msgs/msg/Range"

    stamp_ns: int
    frame_id: str
    radiation_type: int = 0
    field_of_view: float = 0.0
    min_range: float = 0.0
    max_range: float = 0.0
    range: float = 0.0
    variance: float = 0.0

    def __post_init__(self) -> None:
        check_stamp("stamp_ns", self.stamp_ns)
        check_byte("radiation_type", self.radiation_type)
        check_finite("field_of_view", self.field_of_view)


@dataclass(frozen=True, slots=True)
class Imu:
    """Measurements of an inertial sensor at stamp_ns, in the frame of the sensor, `frame_id`.

    `angular_velocity` is in rad/s, `linear_acceleration` in m/s², with that of gravity. Each
    covariance has 3 by 3 numbers about x, y and z, row by row: all are 0 where it is not known, and
    the first is -1 where the sensor does not measure the value, such as the `orientation`.
    """

    __msgtype__: ClassVar[str] = "sensor_msgs/msg/Imu"

    stamp_ns: int
    frame_id: str
    orientation: Quaternion = field(default_factory=Quaternion)
    orientation_covariance: tuple[float, ...] = (0.0,) * 9
    angular_velocity: Vector3 = field(default_factory=Vector3)
    angular_velocity_covariance: tuple[float, ...] = (0.0,) * 9
    linear_acceleration: Vector3 = field(default_factory=Vector3)
    linear_acceleration_covariance: tuple[float, ...] = (0.0,) * 9

    def __post_init__(self) -> None:
        check_stamp("stamp_ns", self.stamp_ns)
        for value in ("orientation", "angular_velocity", "linear_acceleration"):
            check_count(f"{value}_covariance", getattr(self, f"{value}_covariance"), 9)


@dataclass(frozen=True, slots=True)
class NavSatStatus:
    """Whether a receiver of satellites has a fix, and by which `service`: the sum of GPS 1, GLONASS
    2, COMPASS 4, GALILEO 8.
    """

    __msgtype__: ClassVar[str] = "sensor_msgs/msg/NavSatStatus"

    STATUS_UNKNOWN: ClassVar[int] = -2
    STATUS_NO_FIX: ClassVar[int] = -1
    STATUS_FIX: ClassVar[int] = 0
    STATUS_SBAS_FIX: ClassVar[int] = 1
    STATUS_GBAS_FIX: ClassVar[int] = 2
    SERVICE_UNKNOWN: ClassVar[int] = 0
    SERVICE_GPS: ClassVar[int] = 1
    SERVICE_GLONASS: ClassVar[int] = 2
    SERVICE_COMPASS: ClassVar[int] = 4
    SERVICE_GALILEO: ClassVar[int] = 8

    status: int = -2
    service: int = 0

    def __post_init__(self) -> None:
        if not -128 <= self.status < 128:
            raise ValueError(f"status must be from -128 to 127, not {self.status}")
        if not 0 <= self.service < 2**16:
            raise ValueError(f"service must be from 0 to 65535, not {self.service}")


_COVARIANCE_TYPES = {0: "unknown", 1: "approximated", 2: "diagonal known", 3: "known"}


@dataclass(frozen=True, slots=True)
class NavSatFix:
    """A place on Earth at stamp_ns, of the antenna, whose frame is `frame_id`.

    `latitude` and `longitude` in degrees, north and east positive, `altitude` in m above the
    ellipsoid of WGS 84; NaN where it is not known. `position_covariance` has 3 by 3 numbers in m²,
    row by row, about east, north and up.
    """

    COVARIANCE_TYPE_UNKNOWN: ClassVar[int] = 0
    COVARIANCE_TYPE_APPROXIMATED: ClassVar[int] = 1
    COVARIANCE_TYPE_DIAGONAL_KNOWN: ClassVar[int] = 2
    COVARIANCE_TYPE_KNOWN: ClassVar[int] = 3

    __msgtype__: ClassVar[str] = "sensor_msgs/msg/NavSatFix"

    stamp_ns: int
    frame_id: str
    status: NavSatStatus = field(default_factory=NavSatStatus)
    latitude: float = 0.0
    longitude: float = 0.0
    altitude: float = 0.0
    position_covariance: tuple[float, ...] = (0.0,) * 9
    position_covariance_type: int = 0

    def __post_init__(self) -> None:
        check_stamp("stamp_ns", self.stamp_ns)
        for name, most in (("latitude", 90.0), ("longitude", 180.0)):
            degrees = getattr(self, name)
            if abs(degrees) > most:
                raise ValueError(f"{name} must be from -{most:.0f} to {most:.0f}, not {degrees}")
        check_count("position_covariance", self.position_covariance, 9)
        check_one_of("position_covariance_type", self.position_covariance_type, _COVARIANCE_TYPES)
