"""The messages that the page draws beside the frames: found, placed, kept and refused."""

import logging
import math
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path as PathOfFile
from typing import Any, cast
from unittest.mock import MagicMock

import numpy as np
import pytest

from tests.builders import S, moved
from tests.buses import eventually
from tests.simulated_bus import Bus
from tfbus import Buffer, Fleet
from tfbus.base.errors import SettingsError
from tfbus.bus.graph import Endpoint, TopicInfo
from tfbus.frames.moment import BusMoment
from tfbus.frames.snapshot import frame_tree
from tfbus.messages import (
    CameraInfo,
    ColorRGBA,
    CompressedImage,
    Image,
    LaserScan,
    Log,
    MapMetaData,
    Marker,
    MarkerArray,
    OccupancyGrid,
    Odometry,
    Path,
    PointCloud,
    PointStamped,
    Polygon,
    PolygonStamped,
    Pose,
    Pose3D,
    PoseArray,
    PoseStamped,
    PoseWithCovariance,
    PoseWithCovarianceStamped,
    Quaternion,
    Range,
    Vector3,
)
from tfbus.view.data.layer import TopicLayer
from tfbus.view.data.picked import PickedPoint
from tfbus.view.data.shapes import MOST_POINTS, Bodies, Frustum, Lines, Points, Texture
from tfbus.view.data.topics import MOST_BYTES, DataOnBus, Waiting, camera_topic
from tfbus.view.frames import frames_of
from tfbus.view.panels.data import state_of
from tfbus.view.scene.camera import Ray
from tfbus.view.scene.data import DataScenes
from tfbus.view.settings import (
    TopicSettings,
    ViewSettings,
    ViewState,
    load_settings,
    save_settings,
    topic_named,
)
from tfbus.wire.codec import type_name

SETTINGS = TopicSettings("topic", rate_hz=60.0)
POINT = np.array([[1.0, 0.0, 0.0]])


@pytest.fixture
def buffer() -> Buffer:
    """A base that drives a metre a second along the map's x, known from 1 s to 3 s."""
    filled = Buffer()
    for second in (1, 2, 3):
        filled.set_transform(moved(second * S, "map", "base", float(second)))
    return filled


def layer_of(*messages: Any) -> TopicLayer:
    """A layer to which these messages have come."""
    waiting = Waiting(type(messages[0]))
    for message in messages:
        waiting.put(message)
    return TopicLayer(waiting)


def cloud(stamp_ns: int, frame: str = "base", **columns: Any) -> PointCloud:
    """A cloud of one point, a metre ahead."""
    return PointCloud.from_xyz(stamp_ns, frame, POINT, **columns)


def xs(layer: TopicLayer) -> list[float]:
    """The places of the items along x of the fixed frame, in m."""
    return [float(each.pose.xyz[0]) for each in layer.placed.values()]


def test_a_cloud_stays_where_it_was_measured_while_the_robot_drives_on(buffer: Buffer) -> None:
    """Unless it is locked to its frame."""
    stays, follows = layer_of(cloud(2 * S)), layer_of(cloud(2 * S))
    locked = TopicSettings("topic", locked=True)
    stays.step(buffer, "map", 0.0, SETTINGS)
    follows.step(buffer, "map", 0.0, locked)
    buffer.set_transform(moved(5 * S, "map", "base", 5.0))
    stays.step(buffer, "map", 0.1, SETTINGS)
    follows.step(buffer, "map", 0.1, locked)
    assert (xs(stays), xs(follows)) == ([2.0], [5.0])


def test_of_several_clouds_the_newest_that_can_be_placed_is_drawn(buffer: Buffer) -> None:
    """A later one waits for its transform, and then replaces it; after 5 s it is dropped."""
    layer = layer_of(cloud(1 * S), cloud(2 * S), cloud(4 * S))
    layer.step(buffer, "map", 0.0, SETTINGS)
    assert xs(layer) == [2.0]
    buffer.set_transform(moved(4 * S, "map", "base", 4.0))
    layer.step(buffer, "map", 0.1, SETTINGS)
    assert xs(layer) == [4.0]
    layer.waiting.put(cloud(9 * S))
    layer.step(buffer, "map", 1.0, SETTINGS)
    layer.step(buffer, "map", 3.0, SETTINGS)
    assert "base" in layer.trouble
    layer.step(buffer, "map", 6.1, SETTINGS)
    assert (xs(layer), dict(layer.dropped)) == ([4.0], {"no transform": 1})


def test_a_map_waits_for_its_frame_however_long(buffer: Buffer) -> None:
    """It comes once: as what is locked to its frame, or has no stamp."""
    grid = OccupancyGrid.from_cells(2 * S, "floor", np.zeros((2, 3), np.int8), 0.1)
    marks = (marker(0), marker(1, frame_locked=True), replace(marker(2), stamp_ns=0))
    array = MarkerArray(tuple(replace(each, frame_id="floor") for each in marks))
    layers = [layer_of(grid), layer_of(array)]
    for now_s in (0.0, 60.0, 61.0):
        if now_s == 61.0:
            buffer.set_transform(moved(60 * S, "map", "floor", 4.0))
        for layer in layers:
            layer.step(buffer, "map", now_s, SETTINGS)
    assert [*map(xs, layers)] == [[4.0], [4.0, 4.0]]
    assert [dict(layer.dropped) for layer in layers] == [{}, {"no transform": 1}]


def test_clouds_that_decay_stay_for_their_time(buffer: Buffer) -> None:
    """Each at its own place."""
    decaying = TopicSettings("topic", decay_s=2.0, rate_hz=60.0)
    layer = layer_of(cloud(1 * S))
    layer.step(buffer, "map", 0.0, decaying)
    layer.waiting.put(cloud(2 * S))
    layer.step(buffer, "map", 1.0, decaying)
    assert xs(layer) == [1.0, 2.0]
    layer.step(buffer, "map", 2.5, decaying)
    assert xs(layer) == [2.0]


def points_x(layer: TopicLayer) -> list[float]:
    """The places of the points along x of the fixed frame, in m."""
    return [
        float(x)
        for each in layer.placed.values()
        for shape in each.item.shapes
        if isinstance(shape, Points)
        for x in each.pose.apply(shape.xyz.astype(np.float64))[:, 0]
    ]


def test_of_many_clouds_that_decay_none_leaves_early(buffer: Buffer) -> None:
    """Each at its own place, though a browser has few items, which seldom change; they leave almost
    in time.
    """
    decaying = TopicSettings("topic", decay_s=1.5, rate_hz=60.0)
    layer = layer_of(cloud(1 * S))
    stamps_ns = [1 * S + tick * S // 400 for tick in range(801)]
    sent: dict[int, Any] = {}
    for pace_s, stamp_ns in enumerate(stamps_ns):
        layer.waiting.put(cloud(stamp_ns))
        layer.step(buffer, "map", stamp_ns / S, decaying, pace_s=pace_s)
        sent |= {id(each.item): each.item.shapes[0] for each in layer.placed.values()}
    left = [stamp_ns / S + 1.0 for stamp_ns in stamps_ns if stamp_ns > 1.5 * S]
    found = points_x(layer)
    np.testing.assert_allclose(found[-len(left) :], left, atol=1e-6)
    assert len(found) <= len(left) + 20 and len(layer.placed) <= 61
    assert sum(len(each.xyz) for each in sent.values()) < 4 * len(stamps_ns)


def test_points_that_decay_stay_whole_in_another_fixed_frame(buffer: Buffer) -> None:
    """For the time that is left, also if their messages came at once, or as often as it changes;
    without a way to it nothing is drawn.
    """
    buffer.set_transform(moved(0, "map", "floor", -1.0), static=True)
    decaying = TopicSettings("topic", decay_s=9.0, rate_hz=60.0)
    layer = layer_of(cloud(1 * S))
    for tick in range(101):
        stamp_ns = 1 * S + tick * S // 50
        layer.waiting.put(cloud(stamp_ns))
        layer.step(buffer, "map", float(tick > 50), decaying, pace_s=stamp_ns / S)
    found = np.array(points_x(layer))
    for fixed_frame, x, now_s in (("floor", 1.0, 1.0), ("map", 0.0, 8.0), ("floor", 1.0, 8.9)):
        layer.step(buffer, fixed_frame, now_s, decaying)
        np.testing.assert_allclose(points_x(layer), found + x, atol=1e-6)
    layer.step(buffer, "floor", 9.5, decaying)
    assert 0 < len(points_x(layer)) <= 60
    layer.step(buffer, "elsewhere", 9.6, decaying)
    assert not points_x(layer)


def test_points_that_decay_stay_when_their_width_changes(buffer: Buffer) -> None:
    """Only other settings need the messages anew."""
    layer = layer_of(cloud(1 * S))
    found = []
    for second, change in ((1, {}), (2, {"size": 5.0}), (3, {"color": "flat"})):
        layer.waiting.put(cloud(second * S))
        chosen = TopicSettings("topic", decay_s=9.0, **change)  # type: ignore[arg-type]
        layer.step(buffer, "map", float(second), chosen)
        found.append(xs(layer))
    assert found == [[1.0], [1.0, 2.0], [2.0, 3.0]]
    wider, bluer = replace(chosen, size=9.0, rate_hz=3.0), replace(chosen, rgb="#0000ff")
    assert [layer.is_by("map", each) for each in (chosen, wider, bluer)] == [True, True, False]


def test_the_panel_says_that_points_left_early(buffer: Buffer) -> None:
    """Of the points of a topic at most half a million stay. It says so until they had left."""
    many = PointCloud.from_xyz(1 * S, "base", np.ones((200_000, 3)))
    chosen = TopicSettings("topic", decay_s=9.0, most_points=500_000.0)
    layer = layer_of(many)
    said = []
    for second in (0, 1, 2, 3, 11, 13):
        layer.step(buffer, "map", float(second), chosen)
        if second < 2:
            layer.waiting.put(many)
        said.append("the newest 500000 points stay" in state_of(layer))
    assert said == [False, False, True, True, False, False]


def test_a_scan_whose_ranges_have_times_is_straightened(buffer: Buffer) -> None:
    """A wall ahead stays a wall: each range is placed at its own time."""
    scan = LaserScan(1 * S, "base", 0, 0, 0, 1.0, 0, 0.1, 30.0, np.array([5.0, 4.0, 3.0]))
    layer = layer_of(scan)
    layer.step(buffer, "map", 0.0, SETTINGS)
    [placed] = layer.placed.values()
    [points] = placed.item.shapes
    assert isinstance(points, Points)
    np.testing.assert_allclose(placed.pose.apply(points.xyz)[:, 0], 6.0, atol=1e-5)


def test_another_fixed_frame_places_what_is_drawn_anew(buffer: Buffer) -> None:
    """Without another message; without a place in it nothing is drawn."""
    layer = layer_of(cloud(2 * S))
    found = []
    for at, fixed_frame in enumerate(("map", "base", "elsewhere", "map")):
        layer.step(buffer, fixed_frame, float(at), SETTINGS)
        found.append(xs(layer))
    assert found == [[2.0], [0.0], [], [2.0]]


@pytest.mark.parametrize(
    ("color", "columns", "expected"),
    [
        ("flat", {}, (230, 120, 20)),
        ("auto", {"rgb": np.array([0x0A141E], np.uint32)}, (10, 20, 30)),
        ("auto", {"rgb": np.array([0x0A141E], np.uint32).view(np.float32)}, (10, 20, 30)),
        ("ring", {"ring": np.array([np.nan])}, (128, 128, 128)),
        ("no such column", {}, (230, 120, 20)),
    ],
)
def test_points_have_the_colour_of_a_column(
    color: str, columns: Any, expected: tuple[int, ...], buffer: Buffer
) -> None:
    """Or all the same one."""
    layer = layer_of(cloud(2 * S, **columns))
    layer.step(buffer, "map", 0.0, TopicSettings("topic", color=color))
    [placed] = layer.placed.values()
    [points] = placed.item.shapes
    assert isinstance(points, Points)
    assert points.colors.tolist() == [list(expected)]


def points_of(color: str, settings: TopicSettings, buffer: Buffer) -> Points:
    """Points whose column has 0, 1, 2, and so on to 100, as they are drawn."""
    layer = layer_of(PointCloud.from_xyz(2 * S, "base", np.zeros((101, 3)), heat=np.arange(101.0)))
    layer.step(buffer, "map", 0.0, replace(settings, color=color))
    assert layer.trouble == ""
    [placed] = layer.placed.values()
    [points] = placed.item.shapes
    assert isinstance(points, Points)
    assert layer.span == points.span
    return points


def test_the_bounds_of_colours_are_chosen_or_those_in_the_message(buffer: Buffer) -> None:
    """Each bound by itself; numbers beyond them have the first and the last colour."""
    auto = points_of("heat", SETTINGS, buffer)
    chosen = points_of("heat", topic_named("t:color_min=20,color_max=40", ViewSettings()), buffer)
    half = points_of("heat", topic_named("t:color_min=-7,color_max=auto", ViewSettings()), buffer)
    assert (auto.span, chosen.span, half.span) == ((1.0, 99.0), (20.0, 40.0), (-7.0, 99.0))
    first, last = auto.colors[0], auto.colors[-1]
    assert (chosen.colors[:21] == first).all()
    assert (chosen.colors[40:] == last).all()
    assert (chosen.colors[21:40] != first).any(axis=1).all()
    downwards = points_of("heat", replace(SETTINGS, color_min=40.0, color_max=20.0), buffer)
    assert (downwards.colors[40:] == first).all()
    assert (downwards.colors[:21] == last).all()
    assert points_of("flat", SETTINGS, buffer).span is None


def test_equal_numbers_have_the_middle_colour(buffer: Buffer) -> None:
    """Not the first one, which is dark; numbers below and above keep the first and the last."""
    layer = layer_of(PointCloud.from_xyz(2 * S, "base", np.zeros((3, 3)), heat=np.full(3, 100.0)))
    layer.step(buffer, "map", 0.0, replace(SETTINGS, color="heat"))
    [placed] = layer.placed.values()
    [points] = placed.item.shapes
    assert isinstance(points, Points)
    scale = points_of("heat", replace(SETTINGS, color_min=0.0, color_max=100.0), buffer).colors
    assert abs(points.colors.astype(int) - scale[50]).max() <= 2
    middle = points_of("heat", replace(SETTINGS, color_min=50.0, color_max=50.0), buffer).colors
    assert (middle[:50] == scale[0]).all() and (middle[51:] == scale[100]).all()


def test_points_are_as_wide_as_the_settings_say_in_millimetres_or_pixels(buffer: Buffer) -> None:
    """In the scene, or however far away they are."""
    for text, size_px in (("t:size=0.1", 0.0), ("t:size=100,pixels=3", 3.0)):
        assert points_of("heat", topic_named(text, ViewSettings()), buffer).size_px == size_px


def test_many_points_are_thinned_and_others_than_numbers_left_out(buffer: Buffer) -> None:
    """Evenly."""
    xyz = np.zeros((3 * MOST_POINTS, 3), np.float32)
    xyz[::2] = np.nan
    xyz[1::4] = np.inf
    layer = layer_of(PointCloud.from_xyz(2 * S, "base", xyz))
    layer.step(buffer, "map", 0.0, SETTINGS)
    [placed] = layer.placed.values()
    [points] = placed.item.shapes
    assert isinstance(points, Points)
    assert 0 < len(points.xyz) <= MOST_POINTS
    assert np.isfinite(points.xyz).all()


def marker(number: int = 0, **values: Any) -> Marker:
    """A marker of the namespace `some`."""
    whole = {"ns": "some", "id": number, "type": Marker.CUBE, "scale": Vector3(1, 1, 1)}
    return Marker(2 * S, "base", **(whole | values))


def test_markers_come_and_go_by_name_lifetime_and_action(buffer: Buffer) -> None:
    """As in RViz."""
    layer = layer_of(MarkerArray((marker(0), marker(1, lifetime_ns=S), marker(2, ns="other"))))

    def shown(now_s: float, *further: Marker) -> set[object]:
        if further:
            layer.waiting.put(MarkerArray(further))
        layer.step(buffer, "map", now_s, SETTINGS)
        return set(layer.placed)

    assert shown(0.0) == {("some", 0), ("some", 1), ("other", 2)}
    assert shown(1.5) == {("some", 0), ("other", 2)}
    assert shown(1.6, marker(3), marker(0, action=Marker.DELETE)) == {("some", 3), ("other", 2)}
    assert shown(1.7, marker(action=Marker.DELETEALL)) == {("other", 2)}
    assert shown(1.8, marker(ns="", action=Marker.DELETEALL)) == set()


def test_a_marker_that_is_sent_again_counts_once(
    buffer: Buffer, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As many as can be drawn, here 200, are, though all are moved now; one more is refused."""
    monkeypatch.setattr("tfbus.view.data.layer._MOST_MARKERS", 200)
    layer = layer_of(MarkerArray(tuple(map(marker, range(150)))))
    layer.step(buffer, "map", 0.0, SETTINGS)
    layer.waiting.put(MarkerArray(tuple(map(marker, range(201)))))
    layer.step(buffer, "map", 1.0, SETTINGS)
    assert len(layer.placed) == 200
    assert layer.dropped == {"cannot be drawn": 1}


@pytest.mark.parametrize("kind", range(13))
def test_a_marker_of_each_kind_is_drawn_but_meshes_without_a_file(
    kind: int, buffer: Buffer
) -> None:
    """The others of the array are drawn in any case."""
    points = np.array([(0, 0, 0), (1, 0, 0), (0, -1, 0), (-1, 0, 0)], float)
    one = marker(0, type=kind, points=points, color=ColorRGBA(1, 0, 0, 1), text="here")
    layer = layer_of(MarkerArray((one, marker(1))))
    layer.step(buffer, "map", 0.0, SETTINGS)
    is_mesh = kind == Marker.MESH_RESOURCE
    assert (len(layer.placed), layer.dropped.total()) == ((1, 1) if is_mesh else (2, 0))


OTHERS: dict[str, tuple[Any, type]] = {
    "a path": (Path(2 * S, "map", (PoseStamped(0, "map"), PoseStamped(0, "map"))), object),
    "an area": (PolygonStamped(2 * S, "map", Polygon(np.eye(3, dtype=np.float32))), Lines),
    "poses": (PoseArray(2 * S, "map", np.array([(0, 0, 0, 0, 0, 0, 1)])), Bodies),
    "a point": (PointStamped(2 * S, "map"), Bodies),
    "a pose": (PoseStamped(2 * S, "map"), Bodies),
    "doubt": (
        PoseWithCovarianceStamped(
            2 * S, "map", PoseWithCovariance(Pose3D(), tuple(np.eye(6).ravel()))
        ),
        Bodies,
    ),
    "a map": (OccupancyGrid.from_cells(2 * S, "map", np.zeros((2, 3), np.int8), 0.1), Texture),
    "a range": (Range(2 * S, "base", 0, 0.5, 0.1, 4.0, 1.0), Bodies),
    "odometry": (Odometry(2 * S, "map", "base"), Bodies),
}


@pytest.mark.parametrize("kind", OTHERS)
def test_each_other_kind_of_message_is_drawn(kind: str, buffer: Buffer) -> None:
    """By its shapes."""
    message, shape = OTHERS[kind]
    layer = layer_of(message)
    layer.step(buffer, "map", 0.0, SETTINGS)
    [placed] = layer.placed.values()
    assert isinstance(placed.item.shapes[-1], shape)
    assert (layer.drawn, layer.trouble) == (1, "")


def test_an_image_is_a_picture_and_with_its_calibration_in_the_scene(buffer: Buffer) -> None:
    """Blue first if its encoding says so."""
    pixels = np.full((4, 6, 3), (10, 20, 30), np.uint8)
    layer = layer_of(Image.from_pixels(2 * S, "base", pixels, "bgr8"))
    k = (4.0, 0, 3, 0, 4.0, 2, 0, 0, 1)
    layer.step(buffer, "map", 0.0, SETTINGS, CameraInfo(0, "base", 4, 6, k=k))
    assert layer.picture is not None
    assert layer.picture[0, 0].tolist() == [30, 20, 10]
    [placed] = layer.placed.values()
    [frustum] = placed.item.shapes
    assert isinstance(frustum, Frustum)
    assert frustum.fov_y_rad == pytest.approx(2 * np.arctan(0.5))


@pytest.mark.parametrize(
    ("shape", "kind", "encoding"),
    [
        ((4, 6), np.uint8, "mono8"),
        ((4, 6), np.uint16, "16UC1"),
        ((4, 6), np.float32, "32FC1"),
        ((4, 6), np.float64, "64FC1"),
        ((4, 6), np.uint8, "bayer_rggb8"),
        ((4, 6), np.uint16, "bayer_gbrg16"),
        ((4, 6, 2), np.uint8, "yuv422"),
        ((4, 6, 4), np.uint8, "bgra8"),
        ((4, 6, 3), np.uint16, "rgb16"),
        ((3000, 2000), np.uint8, "mono8"),
    ],
)
def test_images_of_each_encoding_are_pictures(
    shape: tuple[int, ...], kind: type, encoding: str, buffer: Buffer
) -> None:
    """Red, green and blue, of a bounded size."""
    pixels = np.arange(np.prod(shape)).reshape(shape).astype(kind)
    layer = layer_of(Image.from_pixels(2 * S, "base", pixels, encoding))
    layer.step(buffer, "map", 0.0, SETTINGS)
    assert layer.trouble == ""
    assert layer.picture is not None
    assert (layer.picture.dtype, layer.picture.shape[2]) == (np.uint8, 3)
    assert max(layer.picture.shape) <= 1280
    assert layer.picture.shape[1] / layer.picture.shape[0] == pytest.approx(
        shape[1] / shape[0], 0.01
    )


def test_what_failed_is_dropped_and_the_rest_stays(buffer: Buffer) -> None:
    """An item that cannot be drawn is counted, and not tried again."""
    array = MarkerArray((marker(1), marker(2)))
    layer = layer_of(array)
    layer.step(buffer, "map", 0.0, SETTINGS)
    bad, good = layer.placed
    layer.fail(ValueError("no such shape"), bad)
    layer.step(buffer, "map", 1.0, SETTINGS)
    assert [*layer.placed] == [good]
    assert layer.dropped["cannot be drawn"] == 1


@pytest.mark.parametrize("found_m", [math.nan, -math.inf])
def test_a_range_without_a_measurement_is_not_drawn_as_free(buffer: Buffer, found_m: float) -> None:
    """Nothing is known ahead, or something too near; infinite, all is free up to the maximum."""
    lengths = []
    for measured_m in (found_m, math.inf):
        layer = layer_of(Range(2 * S, "base", 0, 0.5, 0.1, 4.0, measured_m))
        layer.step(buffer, "map", 0.0, SETTINGS)
        [placed] = layer.placed.values()
        lengths.append([float(each.scales[0, 0]) for each in placed.item.shapes])
    assert lengths == [[], [4.0]]


HOSTILE: dict[str, Callable[[], Any]] = {
    "no columns": lambda: PointCloud.from_array(2 * S, "base", np.zeros(2, [("u", "f4")])),
    "columns of rows": lambda: PointCloud.from_array(
        2 * S, "base", np.zeros(2, [("x", "f4", 3), ("y", "f4"), ("z", "f4")])
    ),
    "no frame": lambda: cloud(2 * S, ""),
    "no pixels": lambda: Image(2 * S, "base"),
    "no picture": lambda: CompressedImage(2 * S, "base", "jpeg", np.frombuffer(b"\xff\xd8", "u1")),
    "a huge map": lambda: OccupancyGrid(
        2 * S, "base", MapMetaData(0, 1e300, 1, 1), np.zeros(1, np.int8)
    ),
    "a huge marker": lambda: marker(scale=Vector3(1e300, 1, 1)),
}


@pytest.mark.parametrize("kind", HOSTILE)
def test_a_message_that_cannot_be_drawn_is_counted_and_the_next_is_drawn(
    kind: str, buffer: Buffer
) -> None:
    """With the reason."""
    message = HOSTILE[kind]()
    layer = layer_of(message)
    layer.step(buffer, "map", 0.0, SETTINGS)
    assert layer.dropped.total() == 1
    assert layer.trouble
    assert not layer.placed


def test_of_points_in_one_cube_one_is_drawn(buffer: Buffer) -> None:
    """And of what is left at most as many as the settings say."""
    grid = np.stack(np.meshgrid(*[np.arange(100)] * 2, [0.0]), axis=-1).reshape(-1, 3) * 0.01
    by_settings = {}
    for text in ("topic", "topic:voxel=10", "topic:voxel=10,most_points=1000", "topic:voxel=1"):
        layer = layer_of(PointCloud.from_xyz(2 * S, "base", grid + 0.005))
        layer.step(buffer, "map", 0.0, topic_named(text, ViewSettings()))
        [placed] = layer.placed.values()
        [points] = placed.item.shapes
        assert isinstance(points, Points)
        by_settings[text.partition(":")[2]] = len(points.xyz)
    assert by_settings == {
        "": 10_000,
        "voxel=10": 100,
        "voxel=10,most_points=1000": 100,
        "voxel=1": 10_000,
    }


def test_a_topic_is_named_with_its_settings() -> None:
    """They go before those of the file; a mistake says which setting is wrong, and the unit."""
    saved = ViewSettings(topics=(TopicSettings("points", shown=False, size=9.0),))
    named = topic_named("points:voxel=5,color=height,locked=true,hidden=old", saved)
    assert named == TopicSettings(
        "points", size=9.0, voxel=5.0, color="height", locked=True, hidden=("old",)
    )
    assert topic_named("/robot7/scan", saved, "robot7").topic == "scan"
    for text, why in (
        ("scan:rate=5", "no setting 'rate'"),
        ("scan:voxel=far", "voxel must be a number"),
        ("scan:quality=100", "quality must be from 5 to 95"),
        ("scan:voxel=0.05", r"0 or from 1 to 100 cm, got 0.05 \(0.05 m is voxel=5\)"),
        ("scan:color_max=high", "color_max must be a number or auto, got 'high'"),
        ("scan:voxel", "'voxel' is not a setting such as"),
        ("scan:topic=points", "'topic=points' is not a setting such as"),
        ("scan:voxel=2001-13-45", "voxel must be a number"),
        (":voxel=5", "':voxel=5' has no topic"),
        ("scan:group=", "group has no value"),
        ("plan:poses=cones", "poses must be one of auto, arrows, axes, none"),
        ("plan:width=200", "width must be from 0 to 100 cm"),
    ):
        with pytest.raises(SettingsError, match=why):
            topic_named(text, saved)


def test_the_page_says_which_fixed_frame_waiting_messages_have(buffer: Buffer) -> None:
    """Of a tree of its own, or that their frame is not there at all."""
    buffer.set_transform(moved(S, "odom", "arm", 1.0))
    scenes = DataScenes(cast(Any, None), cast(Any, None), logging.getLogger("view"))
    frames = frames_of(BusMoment(at_ns=0, tree=frame_tree(buffer, (), 0)), buffer, "map")
    assert scenes.note("map", frames) == ""
    for frame, advice in (("arm", "choose as the fixed frame odom"), ("hand", "no frame hand")):
        layer = scenes.layers["points"] = layer_of(cloud(S, frame), cloud(2 * S, frame))
        for now_s in (0.0, 2.0):
            layer.step(buffer, "map", now_s, SETTINGS)
        said = scenes.note("map", frames)
        assert said.startswith("2 messages wait ") and "to map" in said
        assert said.endswith(advice)
    buffer.set_transform(moved(S, "map", "hand", 1.0))
    layer.step(buffer, "map", 2.1, SETTINGS)
    assert scenes.note("map", frames) == ""


def test_a_picture_of_the_page_shows_images_that_have_no_camera(buffer: Buffer) -> None:
    """An image with a camera is in the scene already, and so is a cloud."""
    scenes = DataScenes(cast(Any, None), cast(Any, None), logging.getLogger("view"))
    image = Image.from_pixels(2 * S, "base", np.zeros((2, 3, 3), np.uint8))
    camera = CameraInfo(2 * S, "base", 2, 3, k=np.diag((3.0, 3.0, 1.0)).ravel())
    for message, known in ((cloud(2 * S), None), (image, camera)):
        layer = scenes.layers["topic"] = layer_of(message)
        layer.step(buffer, "map", 0.0, SETTINGS, known)
        assert layer.placed and not scenes.has_pictures_without_camera
    layer = scenes.layers["topic"] = layer_of(image)
    layer.step(buffer, "map", 0.0, SETTINGS)
    assert scenes.has_pictures_without_camera


def test_a_panel_that_is_made_again_gets_the_picture_that_is_there(buffer: Buffer) -> None:
    """As of a topic that was away for a while; each panel gets a picture once."""
    source, server = MagicMock(is_recorded=False), MagicMock()
    source.topics.return_value = {
        "image": TopicInfo("image", (Endpoint("/camera", type_name(Image)),))
    }
    source.catch_up.side_effect = float
    source.waiting.return_value = layer_of(
        Image.from_pixels(2 * S, "base", np.zeros((2, 3, 3), np.uint8))
    ).waiting
    scenes = DataScenes(server, source, logging.getLogger("view"))
    settings = ViewSettings(topics=(TopicSettings("image"),))
    scenes.see(buffer, "map", settings, is_held=False, is_watched=True)
    scenes.close()  # its thread ends: the steps are those below
    for _ in range(2):
        panel: list[Any] = []
        scenes.show_picture["image"] = panel.append
        for second in range(3):
            scenes.step(float(second))
        assert len(panel) == 1


def test_a_picture_waits_for_the_past_that_is_being_drawn(buffer: Buffer) -> None:
    """Of a recording's cloud with a long decay that takes longer than the page to appear."""
    source, begun, held = MagicMock(is_recorded=True), threading.Event(), threading.Event()
    kind = (Endpoint("/lidar", type_name(PointCloud)),)
    source.topics.return_value = {"points": TopicInfo("points", kind)}
    source.catch_up.side_effect = float
    source.waiting.return_value = Waiting(PointCloud)
    was_held: list[bool] = []

    def past(*_: Any) -> list[Any]:
        begun.set()
        was_held.append(held.wait(0.2))
        return [(buffer, 0.0, [cloud(2 * S)])]

    source.past.side_effect = past
    scenes = DataScenes(MagicMock(), source, logging.getLogger("view"))
    settings = ViewSettings(topics=(TopicSettings("points"),))
    scenes.see(buffer, "map", settings, is_held=False, is_watched=True)
    assert begun.wait(60.0)
    scenes.hold()
    held.set()
    assert was_held == [False] and scenes.layers["points"].placed
    scenes.close()


def test_closing_the_page_ends_the_drawing_of_a_past(buffer: Buffer) -> None:
    """A recording's may take seconds."""
    source, begun = MagicMock(is_recorded=True), threading.Event()
    kind = (Endpoint("/lidar", type_name(PointCloud)),)
    source.topics.return_value = {"points": TopicInfo("points", kind)}
    source.catch_up.side_effect = float
    source.waiting.return_value = Waiting(PointCloud)
    source.past.return_value = ((buffer, 0.0, []) for _ in iter(begun.set, 0))
    scenes = DataScenes(MagicMock(), source, logging.getLogger("view"))
    settings = ViewSettings(topics=(TopicSettings("points"),))
    scenes.see(buffer, "map", settings, is_held=False, is_watched=True)
    assert begun.wait(60.0)
    scenes.close()
    assert scenes._thread is not None and not scenes._thread.is_alive()


def test_the_age_of_what_is_drawn_is_that_when_browsers_get_it(buffer: Buffer) -> None:
    """And stays so until the next message."""
    layer = layer_of(cloud(2 * S))
    layer.was_sent(3 * S)
    assert layer.age_s is None
    layer.step(buffer, "map", 0.0, SETTINGS)
    layer.was_sent(2 * S + S // 4)
    layer.was_sent(9 * S)
    assert layer.age_s == 0.25


def test_messages_wait_in_a_bounded_number_and_size_and_the_newest_stay() -> None:
    """Also if some come while others are put back: the oldest are dropped, and counted."""
    waiting = Waiting(PointCloud)
    for second in range(5):
        waiting.put(cloud(second))
    taken = waiting.take()
    for second in range(5, 8):
        waiting.put(cloud(second))
    waiting.put_back(taken)
    assert [each.stamp_ns for each in waiting.take()] == [3, 4, 5, 6, 7]
    assert waiting.dropped == 3

    texts = Waiting(Log)
    lines = [Log(at, msg="x" * (MOST_BYTES // 3)) for at in range(3)]
    for line in lines:
        texts.put(line)
    assert texts.take() == lines[1:]
    huge = Log(9, msg="x" * 2 * MOST_BYTES)
    texts.put_back(lines)
    texts.put(huge)
    assert texts.take() == [huge]
    assert (texts.received, texts.dropped) == (4, 4)


def test_a_wall_of_one_cell_is_always_seen(buffer: Buffer) -> None:
    """However large the map is, and at its place: the free cells around it do not hide it."""
    cells = np.zeros((5001, 701), np.int8)
    cells[:, 349] = 100
    cells[3333, :] = 100
    cells[:30, :30] = -1
    layer = layer_of(OccupancyGrid.from_cells(2 * S, "map", cells, 0.05))
    layer.step(buffer, "map", 0.0, SETTINGS)
    [placed] = layer.placed.values()
    [texture] = placed.item.shapes
    assert isinstance(texture, Texture)
    height, width = texture.rgba.shape[:2]
    assert max(height, width) <= 2048
    is_wall = texture.rgba[..., 0] == 0
    assert is_wall[:, int(349.5 * 0.05 / texture.width_m * width)].all()
    assert is_wall[int(3333.5 * 0.05 / texture.height_m * height)].all()
    assert is_wall.sum() == height + width - 1
    assert texture.rgba[0, 0, 3] < texture.rgba[-1, 0, 3]


def test_messages_of_a_fleet_are_drawn_at_the_frames_of_their_robots(bus: Bus) -> None:
    """Each robot calls its frames the same; the map is shared. The view is in a namespace too."""
    data = DataOnBus(bus.node("view", namespace="site"), Fleet(("map",)))
    filled = Buffer()
    for at, name in enumerate(("", "robot1/", "robot2/")):
        filled.set_transform(moved(S, "map", f"{name}lidar", float(at)))
        robot = bus.node("robot", namespace=f"site/{name}".rstrip("/"))
        clouds = robot.create_publisher(PointCloud, "points", retained=True)
        clouds.publish(cloud(S, "lidar"))
        markers = robot.create_publisher(MarkerArray, "markers", retained=True)
        markers.publish(MarkerArray((replace(marker(), stamp_ns=S, frame_id="map"),)))
    wanted = [f"{of}{kind}" for of in ("", "robot1/", "robot2/") for kind in ("points", "markers")]
    topics = eventually(lambda: data.topics() if data.topics().keys() >= set(wanted) else None)
    data.want({name: topics[name] for name in wanted})
    found = []
    for name in wanted:
        waiting = data.waiting(name)
        assert waiting is not None
        eventually(lambda waiting=waiting: waiting.received)
        layer = TopicLayer(waiting)
        layer.step(filled, "map", 0.0, SETTINGS)
        found.append(xs(layer))
    assert found == [[0.0], [0.0], [1.0], [0.0], [2.0], [0.0]]


def point_at(layer: TopicLayer, x: float, y: float) -> PickedPoint | None:
    """The point that a ray straight down meets there in the map."""
    scenes = DataScenes(cast(Any, None), cast(Any, None), logging.getLogger("view"))
    scenes.layers["points"] = layer
    return scenes.point_met_by(Ray(np.array((x, y, 9.0)), np.array((0.0, 0.0, -1.0))), "map")


@pytest.mark.parametrize("text", ["t", "t:most_points=1000", "t:voxel=1", "t:locked=true"])
def test_a_point_is_found_in_its_message_however_thinned_it_is_drawn(
    buffer: Buffer, text: str
) -> None:
    """By its index there, with its place in its frame and in the fixed one, and its columns."""
    xyz = np.column_stack((np.arange(3000.0), np.zeros(3000), np.ones(3000)))
    xyz[::7] = np.nan
    names = {"rgb": np.full(3000, 0x0A141E, np.uint32), "ring": np.arange(3000, dtype=np.uint16)}
    layer = layer_of(PointCloud.from_xyz(2 * S, "base", xyz, **names))
    layer.step(buffer, "map", 0.0, topic_named(text, ViewSettings()))
    base_m = 3.0 if "locked" in text else 2.0
    found = point_at(layer, 1500.0 + base_m, 0.0)
    assert found == PickedPoint(
        "points",
        1500,
        {"base": (1500.0, 0.0, 1.0), "map": (1500.0 + base_m, 0.0, 1.0)},
        {"rgb": "#0a141e", "ring": "1500"},
    )
    assert point_at(layer, 1500.5, 0.0) is None


def test_a_point_of_a_straightened_scan_has_its_place_in_both_frames(buffer: Buffer) -> None:
    """Its place in the scan's frame, and in the fixed frame at its own time; with its range."""
    ranges, times = np.array([5.0, 4.0, np.inf, 2.0]), np.array([1.0, 2.0, 3.0, 4.0])
    scan = LaserScan(1 * S, "base", 0, 0, 0, 0.5, 0, 0.1, 30.0, ranges, times)
    layer = layer_of(scan)
    layer.step(buffer, "map", 0.0, SETTINGS)
    found = point_at(layer, 2.5 + 2.0, 0.0)
    assert found is not None
    assert (found.index, found.columns) == (3, {"range": "2", "angle": "0°", "intensity": "4"})
    assert found.places == {"base": (2.0, 0.0, 0.0), "map": (4.5, 0.0, 0.0)}


def test_a_point_of_an_earlier_message_has_a_place_but_no_columns(buffer: Buffer) -> None:
    """Of clouds that decay only the last message is kept; its frame is called as from outside."""
    layer = layer_of(cloud(1 * S, ring=np.array([7.0])))
    layer.waiting.names = Fleet(("map",)).names("robot7")
    for second in (1, 2):
        buffer.set_transform(moved(second * S, "map", "robot7/base", float(second)))
        layer.step(buffer, "map", 0.0, replace(SETTINGS, decay_s=9.0))
        layer._due_s = 0.0
        layer.waiting.put(cloud((second + 1) * S, ring=np.array([8.0])))
    places = {"robot7/base": (1.0, 0.0, 0.0), "map": (3.0, 0.0, 0.0)}
    assert point_at(layer, 2.0, 0.0) == PickedPoint("points", 0, {"map": (2.0, 0.0, 0.0)}, {})
    assert point_at(layer, 3.0, 0.0) == PickedPoint("points", 0, places, {"ring": "8"})


def test_a_topic_is_shown_ten_times_at_most() -> None:
    """Each time costs a subscription, and any page of the view can ask for it."""
    view = ViewState(ViewSettings(topics=(TopicSettings("points"),)))
    for _ in range(20):
        view.show_again("points")
    assert [each.topic for each in view.settings.topics] == [
        "points",
        *(f"points#{number}" for number in range(2, 11)),
    ]


def test_a_topic_is_shown_twice_by_settings_of_each(buffer: Buffer) -> None:
    """A cloud is there by its height and by its intensity, then without the second name again."""
    view = ViewState(ViewSettings(topics=(TopicSettings("points", color="height"),)))
    view.show_again("points")
    view.show_again("points#2")
    view.change_topic("points#2", color="intensity", color_min=0.0, color_max=9.0)
    view.forget_topic("points#3")
    source = MagicMock(is_recorded=False)
    ends = (Endpoint("/lidar", type_name(PointCloud)),)
    source.topics.return_value = {"points": TopicInfo("points", ends)}
    source.catch_up.side_effect = float
    seen = cloud(2 * S, intensity=np.array([5.0]))
    source.waiting.side_effect = {
        name: layer_of(seen).waiting for name in ("points", "points#2", "points#3")
    }.get
    scenes = DataScenes(MagicMock(), source, logging.getLogger("view"))
    found = []
    for forgotten in ("", "points#2"):
        view.forget_topic(forgotten)
        scenes.see(buffer, "map", view.settings, is_held=False, is_watched=True)
        scenes.close()  # its thread ends: the steps are those here
        scenes.step(0.0)
        found.append({name: layer.span for name, layer in scenes.layers.items()})
    assert found == [{"points": (0.0, 0.0), "points#2": (0.0, 9.0)}, {"points": (0.0, 0.0)}]


def test_the_settings_of_topics_are_saved_and_read(tmp_path: PathOfFile) -> None:
    """Wrong ones are refused by name."""
    chosen = TopicSettings(
        "scan", color="height", color_max=2.0, decay_s=2.0, locked=True, rgb="#0a0b0c"
    )
    save_settings(ViewSettings(topics=(chosen,)), tmp_path / "view.yaml")
    assert load_settings(tmp_path / "view.yaml").topics == (chosen,)
    for text, why in (
        ("topics: 3", "list of maps"),
        ("topics: [3]", "list of maps"),
        ("topics: [{topic: a, colour: x}]", "'color'"),
        ("topics: [{topic: a, size: 1000}]", "from 0.1 to 100 cm"),
        ("topics: [{topic: a, rgb: red}]", "such as '#ff8800'"),
    ):
        (tmp_path / "wrong.yaml").write_text(text)
        with pytest.raises(SettingsError, match=why):
            load_settings(tmp_path / "wrong.yaml")


def test_topics_are_found_by_their_type_and_subscribed_only_while_wanted(bus: Bus) -> None:
    """The camera's calibration is found beside its image."""
    robot = bus.node("robot")
    clouds = robot.create_publisher(PointCloud, "points")
    robot.create_publisher(Image, "camera/image_raw")
    robot.create_publisher(CameraInfo, "camera/camera_info")
    robot.create_publisher(Pose, "pose")
    logs = robot.create_publisher(Log, "rosout", retained=True)
    logs.publish(Log(1, msg="before"))
    data = DataOnBus(bus.node("view"))
    topics = eventually(lambda: data.topics() if "points" in data.topics() else None)
    assert camera_topic("camera/image_raw", topics) == "camera/camera_info"
    assert camera_topic("points", topics) == ""

    wanted = {name: topics[name] for name in ("points", "rosout", "pose")}
    data.want(wanted | {"points#2": topics["points"]})
    assert data.waiting("pose") is None
    points, lines, again = map(data.waiting, ("points", "rosout", "points#2"))
    assert points is not None
    assert lines is not None
    assert again is not None
    eventually(lambda: lines.received == 1)

    def comes() -> bool:
        clouds.publish(cloud(1))
        return points.received > 0 and again.received > 0

    eventually(comes)
    data.want({})
    assert data.waiting("points") is None
    subscribed = bus.run("topic", "info", "points")
    assert "view" not in subscribed.stdout


def test_a_topic_that_is_not_drawn_says_why_once(
    bus: Bus, caplog: pytest.LogCaptureFixture
) -> None:
    """A name that is near is named, also before a browser looks; and so are types."""
    robot = bus.node("robot")
    robot.create_publisher(LaserScan, "scan")
    robot.create_publisher(Pose, "pose")
    node = bus.node("view")
    scenes = DataScenes(cast(Any, None), DataOnBus(node), logging.getLogger("view"))
    named = ("scann", "scan", "pose")
    settings = ViewSettings(topics=tuple(map(TopicSettings, named)))

    def says() -> list[str]:
        scenes.see(Buffer(), "map", settings, is_held=False, is_watched=False)
        return [each.getMessage() for each in caplog.records if each.name == "view"]

    scann, pose = eventually(says)
    assert scann.startswith("Topic 'scann' ") and "no such topic" in scann
    assert scann.endswith("did you mean 'scan'?")
    assert "it has Pose" in pose
    scenes.warn_of(named)
    [scan] = says()[2:]
    assert scan.startswith("Topic 'scan' ") and "no message" in scan
    scenes.close()


def test_why_a_marker_is_not_drawn_stays_while_it_comes_again(buffer: Buffer) -> None:
    """Also between its next message and the drawing of that; it goes once all was drawn."""
    layer = layer_of(marker())
    for fails in (True, True, False):
        layer.step(buffer, "map", 0.0, SETTINGS)
        if fails:
            layer.fail(ValueError("no such mesh"), next(iter(layer.placed)))
        assert layer.trouble == "no such mesh"
        layer.was_sent(3 * S)
        assert bool(layer.trouble) is fails
        layer.waiting.put(marker())


KNOWN = PoseWithCovariance(covariance=tuple(map(float, np.eye(6).ravel())))


@pytest.mark.parametrize(
    "message",
    [
        Path(2 * S, "map", (PoseStamped(0, "map"), PoseStamped(0, "map"))),
        PoseStamped(2 * S, "map"),
        PoseArray(2 * S, "map", np.array([[0.0, 0, 0, 0, 0, 0, 1]])),
        PointStamped(2 * S, "map"),
        PoseWithCovarianceStamped(2 * S, "map", KNOWN),
        Odometry(2 * S, "map", "base", KNOWN),
        Range(2 * S, "base", 0, 0.5, 0.1, 4.0, 1.0),
        cloud(2 * S),
    ],
    ids=lambda message: type(message).__name__,
)
def test_a_topic_has_a_colour_an_opacity_and_a_scale(buffer: Buffer, message: Any) -> None:
    """Lines and points have no opacity; cones and ellipsoids are as large as what they mean."""
    own, chosen = layer_of(message), layer_of(message)
    own.step(buffer, "map", 0.0, replace(SETTINGS, color="flat"))
    settings = replace(SETTINGS, color="flat", rgb="#0a0b0c", opacity=0.5, scale=2.0)
    chosen.step(buffer, "map", 0.0, settings)
    [[before], [after]] = ([each.item for each in layer.placed.values()] for layer in (own, chosen))
    assert len(before.shapes) == len(after.shapes)
    for was, found in zip(before.shapes, after.shapes, strict=True):
        has_size = isinstance(found, Bodies) and found.kind != "cone" and found.opacity == 0.5
        if isinstance(found, Bodies):
            assert isinstance(was, Bodies)
            assert found.opacity == was.opacity / 2.0
            assert (found.scales == was.scales * (2.0 if has_size else 1.0)).all()
        if not isinstance(found, Bodies) or has_size or found.kind == "cone":
            assert isinstance(found, Bodies | Lines | Points)
            assert (found.colors == (10, 11, 12)).all()


def lines_and_poses(message: Any, text: str, buffer: Buffer) -> tuple[list[float], list[Bodies]]:
    """The widths of the lines of a message in m, and its bodies, by a text of settings."""
    layer = layer_of(message)
    layer.step(buffer, "map", 0.0, topic_named(text, ViewSettings()))
    [placed] = layer.placed.values()
    shapes = placed.item.shapes
    bodies = [each for each in shapes if isinstance(each, Bodies)]
    return [each.width_m for each in shapes if isinstance(each, Lines)], bodies


def test_a_path_has_a_width_and_its_poses_are_drawn_as_arrows_or_axes(buffer: Buffer) -> None:
    """As in RViz: by itself it is a thin line without poses. Arrows differ from its colour."""
    left = Pose3D(Vector3(1.0, 2.0, 0.0), Quaternion(z=math.sqrt(0.5), w=math.sqrt(0.5)))
    path = Path(2 * S, "map", (PoseStamped(0, "map", left), PoseStamped(0, "map")))
    assert lines_and_poses(path, "plan", buffer) == ([0.0], [])
    widths, [arrows] = lines_and_poses(path, "plan:width=5,poses=arrows,rgb=#0a0b0c", buffer)
    assert widths == [0.05]
    assert (arrows.kind, len(arrows.xyz)) == ("arrow", 2)
    assert (arrows.colors != (10, 11, 12)).any(axis=1).all()
    _, [axes] = lines_and_poses(path, "plan:poses=axes,scale=2,opacity=0.5", buffer)
    middles = [(1.0, 2.3, 0.0), (0.7, 2.0, 0.0), (1.0, 2.0, 0.3)]
    middles += [(0.3, 0.0, 0.0), (0.0, 0.3, 0.0), (0.0, 0.0, 0.3)]
    np.testing.assert_allclose(axes.xyz, middles, atol=1e-6)
    assert axes.scales.max(axis=1) == pytest.approx([0.6] * 6)
    assert axes.scales.argmax(axis=1).tolist() == [0, 1, 2] * 2
    assert (axes.colors.argmax(axis=1).tolist(), axes.opacity) == ([0, 1, 2] * 2, 0.5)
    assert lines_and_poses(replace(path, poses=()), "plan:poses=arrows", buffer)[0] == [0.0]


@pytest.mark.parametrize("poses", ["arrows", "axes"])
def test_a_pose_that_browsers_cannot_place_is_left_out(buffer: Buffer, poses: str) -> None:
    """The others are drawn: browsers have numbers of 32 bits."""
    far = PoseStamped(0, "map", Pose3D(Vector3(1e300, 0.0, 0.0)))
    path = Path(2 * S, "map", (far, PoseStamped(0, "map")))
    array = PoseArray(2 * S, "map", np.array([(1e300, 0, 0, 0, 0, 0, 1), (0, 0, 0, 0, 0, 0, 1)]))
    for message in (path, array):
        _, [found] = lines_and_poses(message, f"plan:poses={poses}", buffer)
        assert len(found.xyz) == {"arrows": 1, "axes": 3}[poses]
        assert np.abs(found.xyz).max() < 1.0


@pytest.mark.parametrize("kind", ["poses", "a pose", "doubt", "odometry"])
def test_poses_of_each_kind_of_message_are_arrows_axes_or_none(kind: str, buffer: Buffer) -> None:
    """The ellipsoid of what is not known stays."""
    kinds = {
        poses: [each.kind for each in lines_and_poses(OTHERS[kind][0], f"t:{poses}", buffer)[1]]
        for poses in ("poses=auto", "poses=axes", "poses=none")
    }
    doubt = ["sphere"] if kind == "doubt" else []
    assert [*kinds.values()] == [["arrow", *doubt], ["cube", *doubt], doubt]


def test_a_costmap_lies_clear_on_the_map_below_it(buffer: Buffer) -> None:
    """In RViz's colours: free cells are clear; all others have the opacity of the topic."""
    cells = np.array([[0, 1, 98, 99, 100, -1, 120]], np.int8)
    layer = layer_of(OccupancyGrid.from_cells(2 * S, "map", cells, 0.05))
    layer.step(buffer, "map", 0.0, replace(SETTINGS, color="costmap", opacity=0.5))
    [placed] = layer.placed.values()
    [texture] = placed.item.shapes
    assert isinstance(texture, Texture)
    wide = texture.rgba.shape[1] // cells.size
    found = texture.rgba[0, ::wide].tolist()
    assert found[0] == [0, 0, 0, 0]
    assert [rgba[3] for rgba in found[1:5]] == [127] * 4
    assert found[1][2] > 250 and found[2][0] > 245
    assert [rgba[:3] for rgba in found[3:5]] == [[0, 255, 255], [255, 0, 255]]
    assert found[5] == found[6]
    assert 0 < found[5][3] < 127
    assert 0.0 < placed.pose.xyz[2] <= 0.01


def test_topics_of_a_hidden_group_are_not_subscribed() -> None:
    """Though they are ticked: the robot sends nothing for them."""
    ends = (Endpoint("/robot", type_name(PointCloud)),)
    source = MagicMock()
    source.topics.return_value = {name: TopicInfo(name, ends) for name in ("a", "b", "c")}
    source.waiting.return_value = None
    scenes = DataScenes(MagicMock(), source, logging.getLogger("view"))
    topics = tuple(
        TopicSettings(name, group=group) for name, group in zip("abc", "xx ", strict=True)
    )
    for hidden, wanted in (((), "abc"), (("x",), "c"), ((" ", "x"), "")):
        settings = ViewSettings(topics=topics, hidden_groups=hidden)
        scenes.see(Buffer(), "map", settings, is_held=False, is_watched=True)
        [found], _ = source.want.call_args
        assert "".join(found) == wanted
    scenes.close()
