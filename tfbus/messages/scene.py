"""Messages of drawings, maps and logs."""

from dataclasses import dataclass, field
from typing import ClassVar

from tfbus.base import lazy_numpy as np
from tfbus.base.lazy_numpy import NDArray
from tfbus.messages.fields import (
    ColorsArray,
    Int8Array,
    PointsArray,
    UInt8Array,
    UvArray,
    WithArrays,
    check_all_finite,
    check_byte,
    check_finite,
    check_one_of,
    check_size,
    check_stamp,
    check_unsigned,
    no_numbers,
)
from tfbus.messages.geometry import Pose3D, Vector3
from tfbus.messages.images import CompressedImage

_INT32 = range(-(2**31), 2**31)


@dataclass(frozen=True, slots=True)
class ColorRGBA:
    """Red, green, blue and opacity, each from 0 to 1."""

    __msgtype__: ClassVar[str] = "std_msgs/msg/ColorRGBA"

    r: float = 0.0
    g: float = 0.0
    b: float = 0.0
    a: float = 0.0

    def __post_init__(self) -> None:
        for name in "rgba":
            check_finite(name, getattr(self, name))


@dataclass(frozen=True, slots=True, eq=False)
class MeshFile(WithArrays):
    """A mesh within a Marker: a file's name, and its bytes."""

    __msgtype__: ClassVar[str] = "visualization_msgs/msg/MeshFile"

    filename: str = ""
    data: UInt8Array = field(default_factory=no_numbers)

    def __post_init__(self) -> None:
        self._make_arrays()


_TYPES = {
    0: "arrow",
    1: "cube",
    2: "sphere",
    3: "cylinder",
    4: "line strip",
    5: "line list",
    6: "cube list",
    7: "sphere list",
    8: "points",
    9: "text facing the view",
    10: "mesh",
    11: "triangle list",
    12: "arrow strip",
}
_ACTIONS = {0: "add or modify", 2: "delete", 3: "delete all"}
# The types drawn at `points`, with a colour for each if there are colours.
_LISTS = (4, 5, 6, 7, 8, 11, 12)


def _empty_texture() -> CompressedImage:
    return CompressedImage(0, "")


@dataclass(frozen=True, slots=True, eq=False)
class Marker(WithArrays):
    """A shape to draw, of the `type` ARROW, CUBE, ..., at `pose` in the frame `frame_id`.

    `ns` and `id` name it: another one of that name replaces it, or with the `action` DELETE takes
    it away; DELETEALL takes all of `ns`, or all if that is empty. It goes after `lifetime_ns`, or
    stays if that is 0. With `frame_locked` it moves with its frame, else it stays where that was at
    stamp_ns; a stamp of 0 stands for the newest time. `scale` is in m. `points` (N, 3) of lists and
    lines are in m from the pose, and `colors` (N, 4) are r, g, b and a from 0 to 1 for each, or
    none. Of a mesh, `mesh_resource` names a file, whose bytes `mesh_file` may have.
    """

    ARROW: ClassVar[int] = 0
    CUBE: ClassVar[int] = 1
    SPHERE: ClassVar[int] = 2
    CYLINDER: ClassVar[int] = 3
    LINE_STRIP: ClassVar[int] = 4
    LINE_LIST: ClassVar[int] = 5
    CUBE_LIST: ClassVar[int] = 6
    SPHERE_LIST: ClassVar[int] = 7
    POINTS: ClassVar[int] = 8
    TEXT_VIEW_FACING: ClassVar[int] = 9
    MESH_RESOURCE: ClassVar[int] = 10
    TRIANGLE_LIST: ClassVar[int] = 11
    ARROW_STRIP: ClassVar[int] = 12
    ADD: ClassVar[int] = 0
    MODIFY: ClassVar[int] = 0
    DELETE: ClassVar[int] = 2
    DELETEALL: ClassVar[int] = 3

    __msgtype__: ClassVar[str] = "visualization_msgs/msg/Marker"
    __times__: ClassVar[tuple[str, ...]] = ("lifetime_ns",)

    stamp_ns: int
    frame_id: str
    ns: str = ""
    id: int = 0
    type: int = 0
    action: int = 0
    pose: Pose3D = field(default_factory=Pose3D)
    scale: Vector3 = field(default_factory=Vector3)
    color: ColorRGBA = field(default_factory=ColorRGBA)
    lifetime_ns: int = 0
    frame_locked: bool = False
    points: PointsArray = field(default_factory=no_numbers)
    colors: ColorsArray = field(default_factory=no_numbers)
    texture_resource: str = ""
    texture: CompressedImage = field(default_factory=_empty_texture)
    uv_coordinates: UvArray = field(default_factory=no_numbers)
    text: str = ""
    mesh_resource: str = ""
    mesh_file: MeshFile = field(default_factory=MeshFile)
    mesh_use_embedded_materials: bool = False

    def __post_init__(self) -> None:
        check_stamp("stamp_ns", self.stamp_ns)
        if self.id not in _INT32:
            raise ValueError(f"id must be from -2^31 to 2^31 - 1, not {self.id}")
        check_one_of("type", self.type, _TYPES)
        check_one_of("action", self.action, _ACTIONS)
        if self.lifetime_ns // 1_000_000_000 not in _INT32:
            raise ValueError(f"lifetime_ns must be less than 2^31 s, not {self.lifetime_ns} ns")
        self._make_arrays()
        check_all_finite("points", self.points)
        check_all_finite("colors", self.colors)
        check_all_finite("uv_coordinates", self.uv_coordinates)
        # Of triangles there may be one for each three points.
        some = (len(self.points), len(self.points) // 3) if self.type == 11 else (len(self.points),)
        if self.type in _LISTS and len(self.colors) not in (0, *some):
            check_size("colors", self.colors, some[0], of="or none, one for each of points")


@dataclass(frozen=True, slots=True)
class MarkerArray:
    """Shapes to draw, of which each has its own frame and stamp."""

    __msgtype__: ClassVar[str] = "visualization_msgs/msg/MarkerArray"

    markers: tuple[Marker, ...] = ()


@dataclass(frozen=True, slots=True)
class MapMetaData:
    """The cells of a map: `width` along x by `height` along y, of `resolution` m each.

    `origin` is the pose of the corner of the first cell in the map's frame; the map was made at
    map_load_time_ns.
    """

    __msgtype__: ClassVar[str] = "nav_msgs/msg/MapMetaData"

    __times__: ClassVar[tuple[str, ...]] = ("map_load_time_ns",)

    map_load_time_ns: int = 0
    resolution: float = 0.0
    width: int = 0
    height: int = 0
    origin: Pose3D = field(default_factory=Pose3D)

    def __post_init__(self) -> None:
        check_stamp("map_load_time_ns", self.map_load_time_ns)
        check_finite("resolution", self.resolution)
        check_unsigned("width", self.width)
        check_unsigned("height", self.height)


@dataclass(frozen=True, slots=True, eq=False)
class OccupancyGrid(WithArrays):
    """A map in the frame `frame_id`: how likely each cell is occupied, from 0 to 100; -1 if that is
    not known.

    `data` are its rows along x, that with the smallest y first. `from_cells` makes one, and `cells`
    reads it.
    """

    __msgtype__: ClassVar[str] = "nav_msgs/msg/OccupancyGrid"

    stamp_ns: int
    frame_id: str
    info: MapMetaData = field(default_factory=MapMetaData)
    data: Int8Array = field(default_factory=no_numbers)

    def __post_init__(self) -> None:
        check_stamp("stamp_ns", self.stamp_ns)
        self._make_arrays()
        check_size("data", self.data, self.info.height, self.info.width, of="height times width")
        if len(self.data) and self.info.resolution <= 0.0:
            raise ValueError(f"resolution must be above 0 m, not {self.info.resolution}")

    @classmethod
    def from_cells(
        cls,
        stamp_ns: int,
        frame_id: str,
        cells: "NDArray[np.int8]",
        resolution: float,
        origin: Pose3D | None = None,
    ) -> "OccupancyGrid":
        """The map of cells (height, width) of `resolution` m, whose first corner is at `origin`.

        Raises ValueError for another shape.
        """
        if cells.ndim != 2:
            raise ValueError(f"cells must have the shape (height, width), not {cells.shape}")
        height, width = cells.shape
        info = MapMetaData(stamp_ns, resolution, width, height, origin or Pose3D())
        return cls(stamp_ns, frame_id, info, cells.reshape(-1))

    def cells(self) -> "NDArray[np.int8]":
        """The cells (height, width), a view of `data` that cannot be written to."""
        return self.data.reshape(self.info.height, self.info.width)


_LEVELS = {10: "debug", 20: "info", 30: "warn", 40: "error", 50: "fatal"}


@dataclass(frozen=True, slots=True)
class Log:
    """A line of a log at stamp_ns: the `level` (10 debug, 20 info, 30 warn, 40 error, 50 fatal),
    the `name` of the logger, the text `msg`, and the place in the source.
    """

    DEBUG: ClassVar[int] = 10
    INFO: ClassVar[int] = 20
    WARN: ClassVar[int] = 30
    ERROR: ClassVar[int] = 40
    FATAL: ClassVar[int] = 50

    __msgtype__: ClassVar[str] = "rcl_interfaces/msg/Log"
    __times__: ClassVar[tuple[str, ...]] = ("stamp_ns",)

    stamp_ns: int
    level: int = 20
    name: str = ""
    msg: str = ""
    file: str = ""
    function: str = ""
    line: int = 0

    def __post_init__(self) -> None:
        check_stamp("stamp_ns", self.stamp_ns)
        check_byte("level", self.level)
        check_unsigned("line", self.line)

    @property
    def level_name(self) -> str:
        """The level in a word: that of the next lower one, if it has none of its own."""
        return next(
            (text for level, text in [*_LEVELS.items()][::-1] if self.level >= level), "debug"
        )
