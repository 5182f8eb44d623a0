"""The tree of frames: no loops, no trace of removed frames, and edges that yield to others."""

import pytest

from tests.builders import S, moved, x_of
from tfbus.base.errors import (
    ConnectivityException,
    LookupException,
    LoopException,
)
from tfbus.buffer.buffer import Buffer
from tfbus.buffer.formats import as_yaml
from tfbus.buffer.info import Change


def test_no_late_sample_brings_an_earlier_parent_back_above_itself() -> None:
    """A static frame that a late sample makes dynamic gets the parent of its newest sample, unless
    that would close a loop.
    """
    buffer = Buffer()
    buffer.set_transform(moved(100 * S, "a", "c"))
    buffer.set_transform(moved(0, "b", "c", 1.0), static=True)
    buffer.set_transform(moved(100 * S, "c", "a", 1.0))
    with pytest.raises(LoopException):
        buffer.set_transform(moved(95 * S, "b", "c", 2.0))
    assert buffer.path("b", "a") == ["a", "c", "b"]
    assert x_of(buffer, "b", "a") == 2.0


def test_a_removed_frame_is_in_no_history() -> None:
    """A frame that hung below a removed one in the past does not come to hang there again."""
    buffer = Buffer()
    buffer.set_transform(moved(109 * S, "d", "c"))
    buffer.set_transform(moved(105 * S, "a", "c"), static=True)
    buffer.remove("d")
    buffer.set_transform(moved(106 * S, "a", "c", 6.0))
    assert [info.name for info in buffer.all_frames()] == ["a", "c"]
    assert buffer.frame("c").parent == "a"
    assert x_of(buffer, "a", "c") == 6.0
    assert "parent: 'a'" in as_yaml(buffer.all_frames())


def test_at_a_time_below_a_removed_frame_nothing_is_known() -> None:
    """Earlier and later samples of other parents still answer, those of the removed one do not,
    even when a frame of that name is there again.
    """
    buffer = Buffer()
    for stamp, parent in ((1, "a"), (2, "a"), (3, "d"), (4, "d"), (5, "a"), (6, "a")):
        buffer.set_transform(moved(stamp * S, parent, "c", float(stamp)))
    buffer.remove("d")
    buffer.set_transform(moved(0, "a", "d", 1.0), static=True)
    assert buffer.lookup_transform("a", "c", round(1.5 * S)).transform.x == 1.5
    assert buffer.lookup_transform("a", "c", round(5.5 * S)).transform.x == 5.5
    with pytest.raises(ConnectivityException, match="had another parent then"):
        buffer.lookup_transform("a", "c", round(3.5 * S))


def test_an_error_names_the_frames_of_a_loop() -> None:
    """At a time between the changes of parents of two frames that were in each other's place."""
    buffer = Buffer()
    for stamp, parent, child in ((1, "a", "b"), (4, "root", "b"), (2, "b", "a"), (5, "root", "a")):
        buffer.set_transform(moved(stamp * S, parent, child))
    for target, source in (("root", "a"), ("b", "a"), ("a", "root")):
        with pytest.raises(ConnectivityException, match=r"'a' -> 'b' -> 'a' .*loop"):
            buffer.lookup_transform(target, source, 3 * S)


def wrong_way_round(authority: str, *, static: bool) -> Buffer:
    """A buffer to which an authority has sent odom -> map instead of map -> odom."""
    buffer = Buffer()
    buffer.set_transform(moved(S, "odom", "map", 1.0), static=static, authority=authority)
    buffer.set_transform(moved(S, "odom", "base"), static=True, authority="robot")
    return buffer


@pytest.mark.parametrize("static", [True, False])
def test_an_edge_whose_publisher_is_gone_yields_to_one_that_would_close_a_loop(static) -> None:
    """The living publisher's edge is taken, and the change is reported; before, it is refused."""
    buffer = wrong_way_round("wrong", static=static)
    changes: list[Change] = []
    buffer.on_change(changes.append)
    with pytest.raises(LoopException):
        buffer.set_transform(moved(2 * S, "map", "odom", 2.0), authority="right")
    buffer.mark_gone(["map"], True, "wrong")
    assert buffer.set_transform(moved(2 * S, "map", "odom", 2.0), authority="right")
    assert x_of(buffer, "map", "base") == 2.0
    assert buffer.frame("map").parent is None
    assert buffer.sent_by("wrong") == {}
    told = [(c.kind, c.frame, c.former_authority) for c in changes]
    assert told == [("publisher gone", "map", "wrong"), ("removed", "map", "wrong")]
    # What the other sends when it is back is what closes the loop now.
    with pytest.raises(LoopException, match="'right'"):
        buffer.set_transform(moved(3 * S, "odom", "map"), authority="wrong")


@pytest.mark.parametrize("static", [True, False])
def test_an_edge_of_an_earlier_epoch_yields_to_one_that_would_close_a_loop(static) -> None:
    """A publisher that was started again, the right way round now, is not refused; a static pose
    that it sends again holds again.
    """
    buffer = wrong_way_round("slam", static=static)
    buffer.forget("slam")
    buffer.set_transform(moved(0, "map", "odom", 2.0), static=static, authority="slam")
    assert x_of(buffer, "map", "base") == 2.0
    buffer.forget("slam")
    buffer.set_transform(moved(0, "map", "odom", 3.0), static=static, authority="slam")
    with pytest.raises(LoopException):
        buffer.set_transform(moved(0, "base", "map"), static=static, authority="other")


def test_samples_of_a_gone_publisher_do_not_make_another_ones_too_old() -> None:
    """What a gone publisher sent for later times is dropped when another sends the frame."""
    buffer = Buffer()
    for stamp in (90, 100, 3600):
        buffer.set_transform(moved(stamp * S, "world", "robot", 1.0), authority="ahead")
    assert not buffer.set_transform(moved(101 * S, "world", "robot", 2.0), authority="right")
    buffer.mark_gone(["robot"], True, "ahead")
    assert buffer.set_transform(moved(101 * S, "world", "robot", 2.0), authority="right")
    assert buffer.frame("robot").newest_ns == 101 * S
    assert x_of(buffer, "world", "robot") == 2.0


def test_a_refused_transform_changes_nothing() -> None:
    """An edge that would close a loop, or is too old, adds no frame and moves none."""
    buffer = Buffer()
    buffer.set_transform(moved(100 * S, "a", "c"))
    buffer.set_transform(moved(0, "b", "c"), static=True)
    buffer.set_transform(moved(100 * S, "c", "a"))
    before = buffer.all_frames()
    with pytest.raises(LoopException):
        buffer.set_transform(moved(95 * S, "new", "c"))
    assert not buffer.set_transform(moved(1 * S, "new", "c"))
    assert [(i.name, i.parent) for i in buffer.all_frames()] == [(i.name, i.parent) for i in before]


def test_a_static_frame_that_another_publisher_only_repeats_stays_static() -> None:
    """One dynamic sample with the pose of a static frame does not end it; a different one does, and
    so does its own publisher, or any where that one is gone.
    """
    buffer = Buffer()
    buffer.set_transform(moved(0, "map", "odom", 1.0), static=True, authority="mount")
    assert buffer.set_transform(moved(9 * S, "map", "odom", 1.0), authority="slam")
    assert buffer.lookup_transform("map", "odom", 100 * S).transform.x == 1.0
    assert (buffer.frame("odom").static, buffer.frame("odom").authority) == (True, "mount")
    buffer.set_transform(moved(10 * S, "map", "odom", 1.5), authority="slam")
    assert not buffer.frame("odom").static
    for authority, gone in (("mount", False), ("slam", True)):
        buffer.set_transform(moved(0, "map", "odom", 1.0), static=True, authority="mount")
        buffer.mark_gone(["odom"], gone, "mount")
        buffer.set_transform(moved(11 * S, "map", "odom", 1.0), authority=authority)
        assert not buffer.frame("odom").static


def test_many_frames_below_one_parent_are_removed_together() -> None:
    """Each of them is removed, the parent with other children stays."""
    buffer = Buffer()
    names = [f"tag_{i}" for i in range(3_000)]
    for name in [*names, "camera"]:
        buffer.set_transform(moved(0, "world", name), static=True, authority="tags")
    buffer.remove_sent(names, "tags")
    assert buffer.frames() == ["camera", "world"]
    buffer.remove("camera")
    buffer.remove("world")
    assert buffer.frames() == []
    with pytest.raises(LookupException):
        buffer.remove("world")


def test_parents_of_different_times_that_form_a_loop_give_no_two_answers() -> None:
    """A is below D and D below A at 110 s: 1 one way, 3 the other."""
    buffer = Buffer(cache_time_s=100.0)
    for parent, child, at, x in (
        ("C", "D", 120, 8),
        ("A", "D", 105, 1),
        ("D", "A", 110, 3),
        ("C", "A", 115, 2),
    ):
        buffer.set_transform(moved(at * S, parent, child, x))
    for target, source in (("A", "D"), ("D", "A")):
        with pytest.raises(ConnectivityException):
            buffer.lookup_transform(target, source, 110 * S)
