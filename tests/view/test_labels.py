"""The names that the scene of `tfbus view` shows in a browser, and its camera's start."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tfbus import FrameInfo

pytest.importorskip("viser", reason="needs viser: the extra view")

from tfbus.frames.moment import State
from tfbus.view.frames import ViewFrame
from tfbus.view.scene.camera import Viewport, overview
from tfbus.view.scene.scene import MOST_NAMES, readable
from tfbus.view.settings import ViewSettings

# Looks down on the origin from 10 m above, x to the right: a metre is 50 pixels on the ground.
ABOVE = Viewport(
    np.array((0.0, 0.0, 10.0)),
    np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]]),
    2.0 * math.atan(0.8),
    (1000, 800),
)


def frame(name: str, state: State = "dynamic") -> ViewFrame:
    """A frame; only its name and state matter here."""
    return ViewFrame(FrameInfo(name, parent="map"), state, 0.0, 1.0, (), "map", 1)


def names(
    places: dict[str, tuple[float, float]],
    settings: ViewSettings | None = None,
    gone: tuple[str, ...] = (),
    shown: frozenset[str] = frozenset(),
) -> set[str]:
    """The names written for frames at these places on the ground, in metres."""
    frames = [frame(name, "gone" if name in gone else "dynamic") for name in places]
    xyz = np.array([(x, y, 0.0) for x, y in places.values()]).reshape(-1, 3)
    return set(readable(frames, xyz, settings or ViewSettings(), 0.1, ABOVE, shown).values())


def test_a_name_is_written_where_no_other_covers_it() -> None:
    """A letter is about 6 pixels wide: 10 pixels beside is too near, 25 above is not."""
    assert names({"a": (0.0, 0.0), "b": (0.2, 0.0), "c": (2.0, 0.0)}) == {"a +1", "c"}
    assert names({"a": (0.0, 0.0), "b": (0.2, 0.5)}) == {"a", "b"}


def test_frames_at_one_place_share_a_name_in_the_order_of_the_tree() -> None:
    """At most three of them, and the number of others."""
    assert names({"map": (0.0, 0.0), "odom": (0.0, 0.0)}) == {"map, odom"}
    assert names({name: (0.0, 0.0) for name in "abcde"}) == {"a, b, c and 2 more"}


def test_a_name_counts_those_that_it_covers() -> None:
    """Also the name of several frames; a name far away covers none."""
    together = {"map": (0.0, 0.0), "odom": (0.0, 0.0)}
    assert names({**together, "base": (0.3, 0.0), "far": (5.0, 0.0)}) == {"map, odom +1", "far"}


def test_a_covered_name_is_counted_where_there_is_room() -> None:
    """Between two names that stand side by side, at the one with room beside it, or at none."""
    side_by_side = {"left": (0.0, 0.0), "right": (0.8, 0.0)}
    shown = frozenset(side_by_side)
    assert names({**side_by_side, "middle": (0.4, 0.0)}, shown=shown) == {"left", "right"}
    apart = {"left": (0.0, 0.0), "middle": (0.8, 0.0), "right": (1.8, 0.0)}
    assert names(apart, shown=frozenset({"left", "right"})) == {"left +1", "right"}


def test_the_selected_name_comes_first_then_those_of_faulty_frames() -> None:
    """Then those already written, so that names do not flicker."""
    crowd = {"a": (0.0, 0.0), "b": (0.1, 0.0), "c": (0.2, 0.0)}
    assert names(crowd, ViewSettings(selected="c"), gone=("b",)) == {"c +2"}
    assert names(crowd, gone=("b",)) == {"b (gone) +2"}
    assert names(crowd, shown=frozenset("c")) == {"c +2"}
    assert names(crowd, ViewSettings(selected="b", names=False)) == {"b"}
    assert names(crowd, ViewSettings(names=False)) == set()


def test_long_names_are_cut_in_the_middle() -> None:
    """The start names the robot, and the end the part."""
    long = "robot1/camera_depth_optical_frame_rectified"
    assert names({long: (0.0, 0.0)}) == {"robot1/camera_d…_frame_rectified"}


def test_what_is_out_of_sight_has_no_name() -> None:
    """Ten metres to the side, or behind the camera."""
    assert names({"here": (0.0, 0.0), "aside": (11.0, 0.0)}) == {"here"}
    behind = np.array([(0.0, 0.0, 11.0)])
    assert readable([frame("behind")], behind, ViewSettings(), 0.1, ABOVE) == {}


@given(
    st.lists(st.tuples(*[st.floats(-9.0, 9.0)] * 2), max_size=60), st.sampled_from((1e-6, 1.0, 3.0))
)
def test_no_name_lies_over_another(places: list[tuple[float, float]], size: float) -> None:
    """Wherever the frames are, together or not; at most 40."""
    frames = [frame(f"frame{at}") for at in range(len(places))]
    xyz = np.array([(x, y, 0.0) for x, y in places]).reshape(-1, 3)
    written = readable(frames, xyz, ViewSettings(), size, ABOVE)
    assert len(written) <= MOST_NAMES
    rows = [int(name.removeprefix("frame")) for name in written]
    # A name is written above its frame, by 0.35 of an axis.
    pixels, _ = ABOVE.project(xyz[rows] + (0.0, 0.0, 0.35 * size))
    half_px = np.array([6.2 * len(text) / 2.0 for text in written.values()])
    apart = np.abs(pixels[:, None] - pixels[None])
    covered = (apart[..., 0] < half_px[:, None] + half_px) & (apart[..., 1] < 17.0)
    assert covered.sum() == len(rows)


@given(st.tuples(*[st.floats(-100.0, 100.0)] * 3), st.floats(0.1, 100.0), st.floats(0.4, 3.0))
def test_the_camera_starts_where_all_is_in_sight(
    middle: tuple[float, float, float], radius_m: float, aspect: float
) -> None:
    """For every size of the scene and shape of the window."""
    position, look_at = overview(np.array(middle), radius_m, aspect)
    ahead = (look_at - position) / np.linalg.norm(look_at - position)
    right = np.cross(ahead, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(ahead, right), ahead], axis=1)
    window = Viewport(position, rotation, math.radians(75.0), (round(800 * aspect), 800))
    ends = np.array(middle) + radius_m * 0.7 * np.array(
        [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-0.3, 0.3)]
    ) / math.sqrt(2.0)
    assert window.sees(*window.project(ends)).all()
