"""Messages as shapes to draw: points, lines, bodies, texts and textures, in bounded numbers."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tfbus import messages
from tfbus.geometry.transform import Transform
from tfbus.geometry.transform_array import TransformArray
from tfbus.view.settings import TopicSettings

Floats = NDArray[np.float32]
Rgb = NDArray[np.uint8]

# More points of a message are never drawn, whatever the settings say: they are thinned, evenly.
MOST_POINTS = 500_000
# Of lines, bodies and poses; and the sides of a map in cells.
MOST_SHAPES = 20_000
_MOST_CELLS = 2048
_FINE_CELLS = 1024
# As for frames: browsers draw with 32 bits.
_FARTHEST_M = 1e15
_POSE_M = 0.3
# The width of an axis of a pose, in parts of its length.
_ARM = 0.07
AXES_RGB = ((217, 48, 48), (60, 160, 60), (40, 90, 220))
_POINT_M = 0.1
_ABOVE_MAP_M = 0.01

_NO_ROWS = np.zeros(0, np.intp)


@dataclass(frozen=True, eq=False)
class Points:
    """Points (N, 3) in m, with a colour for each; `size_m` wide, 0 for the settings' width, or
    `size_px` pixels unless that is 0. `span` has the numbers of the first and the last colour,
    if numbers are coloured. `rows` (N,) are where those of a cloud or scan are in the message.
    """

    xyz: Floats
    colors: Rgb
    size_m: float = 0.0
    size_px: float = 0.0
    span: tuple[float, float] | None = None
    rows: NDArray[np.intp] = field(default_factory=lambda: _NO_ROWS)


@dataclass(frozen=True, eq=False)
class Lines:
    """Lines (N, 2, 3) in m with a colour for each end; `width_m` wide, 0 for 2 pixels."""

    ends: Floats
    colors: Rgb
    width_m: float = 0.0


@dataclass(frozen=True, eq=False)
class Bodies:
    """N bodies of a kind, "cube", "sphere", "cylinder", "cone" or "arrow", 1 m long each way and
    then scaled (N, 3): at `xyz` (N, 3), turned by quat_wxyz (N, 4). Arrows and cones are along x.
    """

    kind: str
    xyz: Floats
    quat_wxyz: Floats
    scales: Floats
    colors: Rgb
    opacity: float = 1.0


@dataclass(frozen=True, eq=False)
class Triangles:
    """Triangles: their corners (3 N, 3) in m, and a colour with opacity (3 N, 4) for each."""

    corners: Floats
    rgba: Rgb


@dataclass(frozen=True, eq=False)
class MeshFromFile:
    """The mesh of a file of a robot, scaled along x, y and z; in its own colours without `rgb`."""

    name: str
    scale: tuple[float, float, float]
    rgb: tuple[int, int, int] | None
    opacity: float = 1.0


@dataclass(frozen=True, eq=False)
class Text:
    """A text that faces the browser, its capital letters `height_m` high."""

    text: str
    height_m: float
    rgb: tuple[int, int, int] = (0, 0, 0)
    opacity: float = 1.0

    def is_like(self, other: "Text") -> bool:
        """Whether both look the same."""
        return (self.text, self.height_m, self.rgb, self.opacity) == (
            *(other.text, other.height_m, other.rgb, other.opacity),
        )


@dataclass(frozen=True, eq=False)
class Texture:
    """A picture with opacity (H, W, 4) in the plane of x and y, the first row at the smallest y."""

    rgba: Rgb
    width_m: float
    height_m: float


@dataclass(frozen=True, eq=False)
class Frustum:
    """A camera's view, z ahead, with its picture (H, W, 3) `depth_m` ahead."""

    fov_y_rad: float
    picture: Rgb
    depth_m: float = 1.0
    quality: int = 75


Shape = Points | Lines | Bodies | Triangles | MeshFromFile | Text | Texture | Frustum


_HERE = Transform()


@dataclass(frozen=True, eq=False)
class Item:
    """Shapes at `pose` in a frame, as it was at stamp_ns, or if `is_locked` as it is.

    An item replaces the one before of its key, and ends `lifetime_s` after it came; 0 is never.
    """

    key: object
    frame_id: str
    stamp_ns: int
    shapes: tuple[Shape, ...]
    pose: Transform = _HERE
    is_locked: bool = False
    lifetime_s: float = 0.0


def items_of(message: Any, settings: TopicSettings, into_fixed: Transform) -> list[Item]:
    """The items of a message of any type but images, markers, odometry and logs.

    `into_fixed` is the pose of its frame in the fixed frame, by which heights are coloured. Raises
    ValueError for a message that cannot be drawn.
    """
    shapes, pose = _SHAPES[type(message)](message, settings, into_fixed)
    return [Item("", message.frame_id, message.stamp_ns, shapes, pose, settings.locked)]


Made = tuple[tuple[Shape, ...], Transform]


def columns_of(message: Any) -> tuple[str, ...]:
    """The names that points of a message can be coloured by, besides "auto" and "flat"."""
    if isinstance(message, messages.LaserScan):
        return ("height", *(("intensity",) if len(message.intensities) else ()))
    if not isinstance(message, messages.PointCloud):
        return ()
    names = [each.name[:40] for each in message.fields if each.count <= 1 and each.name]
    return ("height", *dict.fromkeys(names))[:50]


def _cloud(cloud: messages.PointCloud, settings: TopicSettings, into_fixed: Transform) -> Made:
    missing = [name for name in "xyz" if name not in cloud]
    if missing:
        raise ValueError(f"the cloud lacks the columns {', '.join(missing)}")
    step = _step(len(cloud), settings)
    xyz = cloud.xyz()[::step]
    if xyz.ndim != 2:
        raise ValueError("the columns x, y and z must be numbers")
    return _points(xyz, step, lambda name: _column(cloud, name, step), settings, into_fixed)


def _column(cloud: messages.PointCloud, name: str, step: int) -> NDArray[Any] | None:
    column = cloud[name][::step] if name in cloud else None
    return column if column is not None and column.ndim == 1 else None


def _scan(scan: messages.LaserScan, settings: TopicSettings, into_fixed: Transform) -> Made:
    step = _step(len(scan.ranges), settings)
    intensities = scan.intensities[::step] if len(scan.intensities) else None
    column = {"intensity": intensities}
    return _points(scan.xyz()[::step], step, column.get, settings, into_fixed)


def _points(
    xyz: NDArray[Any],
    step: int,
    column: Callable[[str], NDArray[Any] | None],
    settings: TopicSettings,
    into_fixed: Transform,
) -> Made:
    with np.errstate(invalid="ignore"):
        near = np.flatnonzero((np.abs(xyz) <= _FARTHEST_M).all(axis=1))
    if settings.voxel and len(near):
        near = near[_one_of_each(xyz[near], settings.voxel / 100.0)]
        near = near[:: -(-len(near) // int(settings.most_points))]
    kept = xyz[near].astype(np.float32)
    name = settings.color
    if name == "auto":
        choices = ("rgb", "rgba", "intensity")
        name = next((each for each in choices if column(each) is not None), "height")
    by = column(name)
    span = None
    if name == "flat" or (by is None and name != "height"):
        flat = np.array(settings.painted(RGB_OF[messages.PointCloud]), np.uint8)
        colors = np.broadcast_to(flat, (len(kept), 3))
    elif by is not None and name in ("rgb", "rgba") and by.dtype.itemsize == 4:
        colors = unpacked(by[near])
    else:
        up = into_fixed.as_matrix()[2]
        heights = kept @ up[:3].astype(np.float32) + np.float32(up[3])
        numbers = heights if by is None else by[near]
        span = span_of(numbers, settings.color_min, settings.color_max)
        colors = colored(numbers, span)
    rows = near if step == 1 else near * step
    colors = np.ascontiguousarray(colors)
    return (Points(kept, colors, size_px=settings.pixels, span=span, rows=rows),), _HERE


def _step(count: int, settings: TopicSettings) -> int:
    """Of how many points one is looked at; with voxels of as many as there are within bounds."""
    most = MOST_POINTS if settings.voxel else min(int(settings.most_points), MOST_POINTS)
    return max(1, -(-count // most))


def _one_of_each(xyz: NDArray[Any], side_m: float) -> NDArray[np.intp]:
    """The row of one point in each cube of points (N, 3)."""
    cubes = np.floor(xyz.astype(np.float64) / side_m)
    # Numbers of cubes that differ have the same key by chance only: a point less is no harm.
    keys = cubes @ np.array((1.0, 1_000_003.0, 998_244_353.0))
    _, first = np.unique(keys, return_index=True)
    rows: NDArray[np.intp] = np.sort(first)
    return rows


def transform_of(pose: messages.Pose3D) -> Transform:
    """The pose as a Transform."""
    at, turn = pose.position, pose.orientation
    return Transform((at.x, at.y, at.z), (turn.x, turn.y, turn.z, turn.w))


def _path(path: messages.Path, settings: TopicSettings, into_fixed: Transform) -> Made:
    some = path.poses[:: max(1, -(-len(path.poses) // MOST_SHAPES))]
    along = [(p.position.x, p.position.y, p.position.z) for p in (each.pose for each in some)]
    rgb = settings.painted(RGB_OF[messages.Path])
    line = line_along(np.array(along).reshape(-1, 3), rgb, settings.width / 100.0)
    if settings.poses in ("auto", "none"):
        return (line,), _HERE
    poses = np.array([transform_of(each.pose).as_pose() for each in some]).reshape(-1, 7)
    # In the colour of the line its poses would be lost in it.
    return (line, *_drawn_poses(poses, settings, RGB_OF[messages.PoseArray])), _HERE


def _polygon(
    stamped: messages.PolygonStamped, settings: TopicSettings, into_fixed: Transform
) -> Made:
    corners = stamped.polygon.points
    step = max(1, -(-len(corners) // MOST_SHAPES))
    border = np.vstack((corners[::step], corners[:1]))
    rgb = settings.painted(RGB_OF[messages.PolygonStamped])
    return (line_along(border, rgb, settings.width / 100.0),), _HERE


def line_along(xyz: NDArray[Any], color: tuple[int, int, int], width_m: float = 0.0) -> Lines:
    """A line along points (N, 3)."""
    near = xyz[(np.abs(xyz) <= _FARTHEST_M).all(axis=1)].astype(np.float32)
    ends = np.stack((near[:-1], near[1:]), axis=1) if len(near) else np.zeros((0, 2, 3), np.float32)
    return Lines(ends, np.broadcast_to(np.array(color, np.uint8), ends.shape).copy(), width_m)


def _poses(poses: messages.PoseArray, settings: TopicSettings, into_fixed: Transform) -> Made:
    step = max(1, -(-len(poses.poses) // MOST_SHAPES))
    rgb = settings.painted(RGB_OF[messages.PoseArray])
    return _drawn_poses(poses.poses[::step], settings, rgb), _HERE


def _drawn_poses(
    poses: NDArray[Any], settings: TopicSettings, rgb: tuple[int, int, int]
) -> tuple[Bodies, ...]:
    """Poses (N, 7) as arrows along x, unless the settings say otherwise."""
    if settings.poses == "none":
        return ()
    poses = poses[(np.abs(poses[:, :3]) <= _FARTHEST_M).all(axis=1)]
    arrays = TransformArray(poses[:, :3], poses[:, 3:])
    long_m = settings.scale * _POSE_M
    if settings.poses == "axes":
        return (_axes(arrays, long_m, settings.opacity),)
    lengths = np.array((long_m, settings.scale * 0.06, settings.scale * 0.06), np.float32)
    return (
        Bodies(
            "arrow",
            arrays.xyz.astype(np.float32),
            arrays.quat_wxyz.astype(np.float32),
            np.tile(lengths, (len(poses), 1)),
            np.tile(np.array(rgb, np.uint8), (len(poses), 1)),
            settings.opacity,
        ),
    )


def _axes(poses: TransformArray, long_m: float, opacity: float) -> Bodies:
    """A red, a green and a blue arm from each pose, along its x, y and z."""
    arms = np.eye(3) * long_m
    middles = poses.xyz[:, None] + poses.as_matrix()[:, :3, :3].transpose(0, 2, 1) * long_m / 2.0
    count = len(poses.xyz)
    return Bodies(
        "cube",
        middles.reshape(-1, 3).astype(np.float32),
        np.repeat(poses.quat_wxyz, 3, axis=0).astype(np.float32),
        np.tile(np.maximum(arms, _ARM * long_m).astype(np.float32), (count, 1)),
        np.tile(np.array(AXES_RGB, np.uint8), (count, 1)),
        opacity,
    )


def _pose_at(pose: messages.Pose3D, settings: TopicSettings) -> tuple[Bodies, ...]:
    rgb = settings.painted(RGB_OF[messages.PoseStamped])
    return _drawn_poses(np.array([transform_of(pose).as_pose()]), settings, rgb)


def _pose(stamped: messages.PoseStamped, settings: TopicSettings, into_fixed: Transform) -> Made:
    return _pose_at(stamped.pose, settings), _HERE


def _point(stamped: messages.PointStamped, settings: TopicSettings, into_fixed: Transform) -> Made:
    at = stamped.point
    ball = Bodies(
        "sphere",
        np.array([(at.x, at.y, at.z)], np.float32),
        np.array([(1.0, 0.0, 0.0, 0.0)], np.float32),
        np.full((1, 3), settings.scale * _POINT_M, np.float32),
        np.array([settings.painted(RGB_OF[messages.PointStamped])], np.uint8),
        settings.opacity,
    )
    return (ball,), _HERE


def _pose_with_covariance(
    stamped: messages.PoseWithCovarianceStamped, settings: TopicSettings, into_fixed: Transform
) -> Made:
    return pose_and_doubt(stamped.pose, settings), _HERE


def pose_and_doubt(
    pose: messages.PoseWithCovariance, settings: TopicSettings
) -> tuple[Bodies, ...]:
    """A pose, and its ellipsoid."""
    return (*_pose_at(pose.pose, settings), *_ellipsoid(pose, settings.opacity))


def _ellipsoid(pose: messages.PoseWithCovariance, opacity: float) -> tuple[Bodies, ...]:
    """The ellipsoid of two standard deviations of the position; none if that is not known."""
    matrix = np.array(pose.covariance, np.float64).reshape(6, 6)[:3, :3]
    if not matrix.any() or not np.isfinite(matrix).all() or np.abs(matrix).max() > _FARTHEST_M:
        return ()
    variances, axes = np.linalg.eigh((matrix + matrix.T) / 2.0)
    if np.linalg.det(axes) < 0.0:
        axes[:, 0] = -axes[:, 0]
    whole = np.eye(4)
    whole[:3, :3] = axes
    at = pose.pose.position
    turn = Transform.from_matrix(whole).quat_xyzw
    lengths = 4.0 * np.sqrt(np.clip(variances, 1e-8, None))
    return (
        Bodies(
            "sphere",
            np.array([(at.x, at.y, at.z)], np.float32),
            np.array([(turn[3], *turn[:3])], np.float32),
            lengths[None].astype(np.float32),
            np.array([(150, 80, 200)], np.uint8),
            0.35 * opacity,
        ),
    )


def _grid(grid: messages.OccupancyGrid, settings: TopicSettings, into_fixed: Transform) -> Made:
    cells = grid.cells()
    if not cells.size:
        return (), _HERE
    height, width = cells.shape
    step = max(1, -(-max(height, width) // _MOST_CELLS))
    cell_m = grid.info.resolution
    width_m, height_m = width * cell_m, height * cell_m
    if max(width_m, height_m) > _FARTHEST_M:
        raise ValueError("the map is too large to be drawn")
    coarse = _coarse(cells, step)
    # Browsers blur the borders of pixels.
    large = max(1, _FINE_CELLS // max(height, width))
    fine = np.repeat(np.repeat(coarse, large, axis=0), large, axis=1)
    side_m = step * cell_m
    is_costs = settings.color == "costmap"
    rgba = _COSTS[fine.view(np.uint8)] if is_costs else of_cells(fine)
    if settings.opacity < 1.0:
        rgba[..., 3] = rgba[..., 3] * settings.opacity
    texture = Texture(rgba, coarse.shape[1] * side_m, coarse.shape[0] * side_m)
    pose = transform_of(grid.info.origin)
    # In one plane with the map below, browsers would show parts of either.
    return (texture,), pose @ Transform((0.0, 0.0, _ABOVE_MAP_M)) if is_costs else pose


def _coarse(cells: NDArray[np.int8], step: int) -> NDArray[np.int8]:
    """A cell for each `step` by `step` of them: the most occupied one, so that no wall is lost."""
    if step == 1:
        return cells
    known = np.where((cells >= 0) & (cells <= 100), cells, np.int8(-1))
    height, width = cells.shape
    rows = np.maximum.reduceat(known, np.arange(0, height, step), axis=0)
    coarse: NDArray[np.int8] = np.maximum.reduceat(rows, np.arange(0, width, step), axis=1)
    return coarse


def _range(found: messages.Range, settings: TopicSettings, into_fixed: Transform) -> Made:
    length = found.max_range if found.range == math.inf else found.range
    angle = min(max(found.field_of_view, 0.01), 3.0)
    if not math.isfinite(length) or not 0.0 < length <= _FARTHEST_M:
        return (), _HERE
    wide = 2.0 * length * math.tan(angle / 2.0)
    cone = Bodies(
        "cone",
        np.zeros((1, 3), np.float32),
        np.array([(1.0, 0.0, 0.0, 0.0)], np.float32),
        np.array([(length, wide, wide)], np.float32),
        np.array([settings.painted(RGB_OF[messages.Range])], np.uint8),
        0.4 * settings.opacity,
    )
    return (cone,), _HERE


_SHAPES: Mapping[type, Callable[[Any, TopicSettings, Transform], Made]] = {
    messages.PointCloud: _cloud,
    messages.LaserScan: _scan,
    messages.Path: _path,
    messages.PointStamped: _point,
    messages.PolygonStamped: _polygon,
    messages.PoseArray: _poses,
    messages.PoseStamped: _pose,
    messages.PoseWithCovarianceStamped: _pose_with_covariance,
    messages.OccupancyGrid: _grid,
    messages.Range: _range,
}


# From low to high: dark blue, cyan, green, yellow, red. They differ in brightness too.
_STOPS = np.array(
    [(48, 18, 120), (40, 110, 235), (30, 200, 190), (120, 220, 70), (240, 200, 40), (220, 50, 20)],
    np.float64,
)
_TABLE = np.stack(
    [np.interp(np.linspace(0, 5, 256), np.arange(6), channel) for channel in _STOPS.T], axis=1
).astype(np.uint8)

# The colours of messages whose shapes have one, which settings can change.
RGB_OF: Mapping[type, tuple[int, int, int]] = {
    messages.PointCloud: (230, 120, 20),
    messages.LaserScan: (230, 120, 20),
    messages.Path: (40, 180, 60),
    messages.PointStamped: (230, 120, 20),
    messages.PolygonStamped: (40, 180, 60),
    messages.PoseArray: (200, 40, 90),
    messages.PoseStamped: (200, 40, 90),
    messages.PoseWithCovarianceStamped: (200, 40, 90),
    messages.Odometry: (230, 120, 20),
    messages.Range: (230, 190, 40),
}


def span_of(
    numbers: NDArray[Any], least: float | None = None, most: float | None = None
) -> tuple[float, float]:
    """The numbers of the first and the last colour: for None the lowest and the highest of the
    finite ones among `numbers` (N,), but for a hundredth of them.
    """
    if least is None or most is None:
        values = numbers.astype(np.float64)
        values = values[np.isfinite(values)]
        low, high = np.percentile(values, (1.0, 99.0)) if len(values) else (0.0, 1.0)
        least = float(low) if least is None else least
        most = float(high) if most is None else most
    return least, most


def colored(numbers: NDArray[Any], span: tuple[float, float]) -> Rgb:
    """Colours (N, 3) of numbers (N,), from the first to the last of a span, which may be downwards.

    Numbers that are not finite are grey; of a span without length its number has the middle colour.
    """
    values = numbers.astype(np.float64)
    finite = np.isfinite(values)
    colors = np.full((len(values), 3), 128, np.uint8)
    low, high = span
    with np.errstate(over="ignore", invalid="ignore"):
        wide, above = high - low, values[finite] - low
        parts = above / wide if abs(wide) > 1e-9 else 0.5 + above / 1e-9
    steps = np.nan_to_num(np.clip(parts, 0.0, 1.0) * 255.0).astype(np.uint8)
    colors[finite] = _TABLE[steps]
    return colors


def unpacked(column: NDArray[Any]) -> Rgb:
    """Colours (N, 3) of a column `rgb` or `rgba` of PCL's: 0xAARRGGBB, also as a float32."""
    packed = np.ascontiguousarray(column)
    if packed.dtype.kind == "f":
        packed = packed.astype(np.float32).view(np.uint32)
    bits = packed.astype(np.uint32)
    return np.stack([(bits >> shift) & 0xFF for shift in (16, 8, 0)], axis=1).astype(np.uint8)


def of_cells(cells: NDArray[np.int8]) -> NDArray[np.uint8]:
    """Colours with opacity (H, W, 4) of a map: free is white, occupied black, unknown faint."""
    known = (cells >= 0) & (cells <= 100)
    level = (255 - np.clip(cells, 0, 100).astype(np.float64) * 2.55).astype(np.uint8)
    rgba = np.empty((*cells.shape, 4), np.uint8)
    rgba[..., :3] = np.where(known, level, 120)[..., None]
    rgba[..., 3] = np.where(known, 230, 90)
    return rgba


def _cost_colors() -> Rgb:
    """RViz's colours with opacity (256, 4) of the bytes of a costmap's cells: free ones are clear,
    others from blue to red, cyan touches an obstacle, magenta is one; unknown is faint.
    """
    rgba = np.full((256, 4), (112, 137, 134, 90), np.uint8)
    rgba[0] = 0
    parts = np.arange(1, 99) * 2.55
    rgba[1:99] = np.stack((parts, 0 * parts, 255 - parts, 0 * parts + 255), axis=1).astype(np.uint8)
    rgba[99], rgba[100] = (0, 255, 255, 255), (255, 0, 255, 255)
    return rgba


_COSTS = _cost_colors()
