"""The views of the page's cameras, and the selected frame of each browser."""

import math
import tracemalloc
from itertools import count
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.view.cameras import Server, camera, distance_m
from tfbus import Transform

pytest.importorskip("viser", reason="needs viser: the extra view")

from tfbus.view.frames import Placed
from tfbus.view.panels.markup import unless_it_left
from tfbus.view.scene.camera import FRONT, Cameras, around, region_of, with_points
from tfbus.view.scene.drawn import Region
from tfbus.view.settings import Selections

ARM = Region(np.array((8.0, 4.0, 1.0)), 0.5)


def test_a_focus_moves_the_camera_of_one_browser_to_the_frame() -> None:
    """From the side where it is, and near enough; one that is nearer stays so."""
    far, other = camera((0.0, -50.0, 0.0), (0.0, 0.0, 0.0)), camera((9.0, 9.0, 9.0), (0, 0, 0))
    cameras = Cameras(Server(far, other))
    cameras.focus(0, ARM)
    assert far.look_at.tolist() == [8.0, 4.0, 1.0]
    assert far.position == pytest.approx((8.0, 4.0 - 0.5 / math.sin(math.radians(37.5)), 1.0))
    assert other.look_at.tolist() == [0, 0, 0]

    far.position = np.array((8.0, 3.9, 1.0))
    cameras.focus(0, ARM)
    assert distance_m(far) == pytest.approx(0.1)
    cameras.focus(7, ARM)


def test_all_is_shown_from_where_cameras_start() -> None:
    """Wherever the camera has been, and in this browser alone."""
    lost, other = camera((0.0, 0.0, -900.0), (0.0, 0.0, -1000.0)), camera((9, 9, 9), (0, 0, 0))
    Cameras(Server(lost, other)).show(0, ARM)
    assert lost.look_at.tolist() == [8.0, 4.0, 1.0]
    assert lost.position[2] > 1.0
    assert other.position.tolist() == [9, 9, 9]


def test_a_view_from_above_is_nearly_without_perspective_and_all_ends_it() -> None:
    """It looks straight down, y up; a focus keeps the direction, another view of all does not."""
    seen = camera((9.0, 9.0, 9.0), (0.0, 0.0, 0.0))
    cameras = Cameras(Server(seen))
    before = seen.fov
    cameras.show_from_above(0, ARM)
    assert seen.look_at.tolist() == [8.0, 4.0, 1.0]
    assert seen.position - seen.look_at == pytest.approx((0, 0, distance_m(seen)), abs=1e-3)
    assert seen.position[1] < 4.0
    assert distance_m(seen) * math.tan(seen.fov / 2.0) == pytest.approx(0.5, rel=0.05)
    assert seen.fov < before / 3.0

    cameras.focus(0, Region(np.zeros(3), 0.25))
    assert seen.position[2] == pytest.approx(distance_m(seen))
    assert distance_m(seen) * math.tan(seen.fov / 2.0) == pytest.approx(0.25, rel=0.05)
    cameras.show(0, ARM)
    assert seen.fov == before


def test_cameras_keep_what_they_see_when_the_fixed_frame_changes() -> None:
    """They look at the same point, from as far; so do browsers that are opened later."""
    server = Server(camera((8.0, 0.0, 2.0), (8.0, 4.0, 1.0)))
    cameras = Cameras(server)
    cameras.aim(ARM, False, 3)
    seen = server.clients[0].camera
    before_m = distance_m(seen)
    moved = Transform.from_rpy(0.3, 0.2, 1.0, xyz=(5.0, -4.0, 3.0))
    cameras.carry(moved)
    assert seen.look_at == pytest.approx(moved.apply(ARM.middle))
    assert distance_m(seen) == pytest.approx(before_m)
    assert server.initial_camera.look_at == pytest.approx(moved.apply(ARM.middle))


def test_browsers_that_have_left_take_no_memory() -> None:
    """Each time that a page is loaded it is another browser."""
    server = Server()
    cameras = Cameras(server)

    def load_pages() -> int:
        for _ in range(200):
            server.clients = {next(numbers): SimpleNamespace(camera=camera((1, 1, 1), (0, 0, 0)))}
            cameras.aim(ARM, False, 3)
        return tracemalloc.get_traced_memory()[0]

    numbers = count()
    tracemalloc.start()
    try:
        first, second = load_pages(), load_pages()
    finally:
        tracemalloc.stop()
    assert second - first < 20_000


def test_cameras_that_the_user_has_not_moved_follow_a_robot_that_is_being_built(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Long after the first frame, each time that more of it is there; others stay."""
    now_s = [0.0]
    monkeypatch.setattr("time.monotonic", lambda: now_s[0])
    left, moved = camera((1.0, 0.0, 2.0), (0, 0, 0)), camera((1.0, 0.0, 2.0), (0, 0, 0))
    cameras = Cameras(Server(left, moved))
    cameras.aim(Region(np.zeros(3), 1.0), True, 3, (0, 2))
    moved.position = np.array((9.0, 9.0, 9.0))
    now_s[0] = 300.0
    cameras.aim(ARM, True, 4, (1, 1))
    assert left.look_at.tolist() == [8.0, 4.0, 1.0]
    assert moved.position.tolist() == [9.0, 9.0, 9.0]
    cameras.aim(Region(np.zeros(3), 1.0), True, 5, (1, 1))
    assert left.look_at.tolist() == [8.0, 4.0, 1.0]
    cameras.carry(Transform((0.0, 0.0, 5.0)))
    cameras.aim(Region(np.zeros(3), 1.0), True, 5, (1, 2))
    assert left.look_at.tolist() == [0.0, 0.0, 0.0]
    assert moved.position.tolist() == [9.0, 9.0, 14.0]


def test_the_first_look_has_the_messages_in_it_that_are_near_the_frames() -> None:
    """One point that is very far away changes nothing."""
    frames = Region(np.zeros(3), 1.0)
    cloud = np.array([(0.0, 0.0, 0.0), (5.0, 0.0, 0.0), (0.0, 1e9, 0.0)])
    seen = with_points(frames, cloud)
    assert seen.middle.tolist() == [2.0, 0.0, 0.0]
    assert seen.radius_m == 3.0
    assert with_points(frames, cloud[2:]) is with_points(frames, cloud[:0]) is frames


def test_cameras_that_the_user_has_not_moved_take_in_a_topic_that_is_drawn_later() -> None:
    """Once: where it goes then they stay."""
    server = Server(camera((1.0, 0.0, 2.0), (0, 0, 0)))
    cameras = Cameras(server)
    looks = [(3, (0, 0, 0), 0.0), (3, (1, 0, 0), 8.0), (3, (1, 0, 0), 8.0)]
    for (frames, built, expected), x in zip(looks, (0.0, 8.0, 12.0), strict=True):
        cameras.aim(Region(np.array((x, 0.0, 0.0)), 1.0), False, frames, built)
        assert server.clients[0].camera.look_at[0] == expected


class Hidden(SimpleNamespace):
    """A camera whose canvas has no height."""

    @property
    def aspect(self) -> float:
        """As viser's."""
        return 640.0 / 0


def test_a_canvas_without_a_size_holds_up_no_browser() -> None:
    """Its camera moves, and so do those of the others."""
    hidden = Hidden(position=np.array((1.0, 0.0, 2.0)), look_at=np.zeros(3))
    seen = camera((1.0, 0.0, 2.0), (0, 0, 0))
    Cameras(Server(hidden, seen)).aim(ARM, True, 3)
    assert hidden.look_at.tolist() == seen.look_at.tolist() == [8.0, 4.0, 1.0]


def test_a_camera_at_the_start_that_it_was_given_is_where_it_was_left() -> None:
    """A browser that is open takes the start, too, and may tell so after it was moved."""
    seen = camera((1.0, 0.0, 2.0), (0, 0, 0))
    seen.aspect = 0.9
    server = Server(seen)
    cameras = Cameras(server)
    cameras.aim(Region(np.zeros(3), 1.0), True, 3, (1, 1))
    cameras.aim(Region(np.zeros(3), 2.0), True, 3, (1, 2))
    seen.position = np.array(server.initial_camera.position)
    cameras.aim(ARM, True, 3, (1, 3))
    assert seen.look_at.tolist() == [8.0, 4.0, 1.0]


def test_frames_that_have_nothing_in_common_with_the_former_ones_are_shown_whole() -> None:
    """In all browsers, and in those that are opened later."""
    server = Server(camera((0.0, -50.0, 0.0), (0.0, 0.0, 0.0)))
    Cameras(server).refit(ARM)
    assert server.clients[0].camera.look_at.tolist() == [8.0, 4.0, 1.0]
    assert server.initial_camera.look_at.tolist() == [8.0, 4.0, 1.0]


def test_the_region_of_frames_is_around_all_of_them() -> None:
    """It is never so small that a single frame fills the picture."""
    xyz = np.array([(0.0, 0.0, 0.0), (10.0, 2.0, 0.0)])
    quat_wxyz = np.array([(1.0, 0.0, 0.0, 0.0)] * 2)
    placed = Placed(("a", "b"), xyz, quat_wxyz, {})
    assert region_of(placed).middle.tolist() == [5.0, 1.0, 0.0]
    assert region_of(placed).radius_m == 8.5
    assert region_of(placed.without(("b",))).radius_m == 0.85
    assert region_of(placed.without(("a", "b"))).radius_m == 0.85


def test_a_ball_around_two_holds_both_and_no_more() -> None:
    """A ball inside another adds nothing."""
    small = Region(np.array((5.0, 0.0, 0.0)), 1.0)
    both = around(Region(np.zeros(3), 2.0), small)
    assert (both.middle.tolist(), both.radius_m) == ([2.0, 0.0, 0.0], 4.0)
    large = Region(np.zeros(3), 7.0)
    for found in (around(large, small), around(small, large)):
        assert (found.middle.tolist(), found.radius_m) == (large.middle.tolist(), large.radius_m)


def test_all_is_seen_from_where_the_first_look_is_however_large_clouds_are() -> None:
    """Neither clouds larger than the frames, nor smaller clouds, nor clouds beside them turn it."""
    frames, robot = Region(np.zeros(3), 1.0), Region(np.zeros(3), 1.0, FRONT)
    for middle, radius_m in (
        ((0.0, 0.0, 0.0), 9.0),
        ((0.0, 0.0, 0.0), 0.1),
        ((5.0, 0.0, 0.0), 1.0),
    ):
        cloud = Region(np.array(middle), radius_m, FRONT)
        assert around(frames, cloud).toward is None
        assert around(robot, cloud).toward is FRONT


def test_a_browser_that_leaves_is_no_error() -> None:
    """viser refuses to change its elements; an error of one that stays is raised."""
    server: Any = Server(camera((0.0, 0.0, 1.0), (0.0, 0.0, 0.0)))
    with unless_it_left(server, 1):
        raise RuntimeError("removed")
    with pytest.raises(RuntimeError, match="removed"), unless_it_left(server, 0):
        raise RuntimeError("removed")


def test_each_browser_has_a_selection_of_its_own() -> None:
    """A new one starts with the last one of all, so that a reload keeps it."""
    selections = Selections("base")
    selections.keep([1, 2])
    selections.select(1, "tool")
    assert [selections.of(1), selections.of(2)] == ["tool", "base"]
    selections.keep([2, 3])
    assert [selections.of(2), selections.of(3)] == ["base", "tool"]


@pytest.mark.parametrize("turns", [False, True])
def test_a_followed_frame_stays_in_the_picture_and_the_camera_in_the_hands_of_its_user(
    turns: bool,
) -> None:
    """The camera is moved once, to look at it; then everything else moves. It turns on request."""
    server = Server(camera((8.0, 0.0, 2.0), (8.0, 4.0, 1.0)))
    cameras, seen = Cameras(server), server.clients[0].camera
    cameras.follow("base", Transform((20.0, 5.0, 0.0)), 1.0, turns=turns)
    assert seen.look_at.tolist() == [20.0, 5.0, 0.0]
    seen.position = by_hand = np.array((21.0, 5.0, 9.0))
    for degrees in range(0, 360, 30):
        pose = Transform.from_rpy(0.1, 0.0, math.radians(degrees), xyz=(degrees, 7.0, 2.0))
        cameras.follow("base", pose, 1.0, turns=turns)
        assert cameras.fixed.apply(pose.xyz) == pytest.approx((20.0, 5.0, 0.0))
        ahead = cameras.fixed.rotate(pose.rotate((1.0, 0.0, 0.0)))
        heading = 0.0 if turns else math.radians(degrees)
        assert ahead[:2] == pytest.approx((math.cos(heading), math.sin(heading)))
        assert cameras.fixed.rotate((0.0, 0.0, 1.0)) == pytest.approx((0.0, 0.0, 1.0))
    assert seen.position is by_hand
    cameras.follow("", None, 1.0, turns=turns)
    cameras.focus(0, Region(np.array(pose.xyz), 1.0))
    assert seen.look_at == pytest.approx((20.0, 5.0, 0.0))
