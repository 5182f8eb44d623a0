"""The buffer: inserted transforms come out, between any two frames, at any known time."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.builders import S, examples, moved
from tfbus.base.errors import (
    ConnectivityException,
    ExtrapolationException,
    FutureExtrapolationException,
    InvalidArgumentException,
    LookupException,
    LoopException,
    NoDataException,
    PastExtrapolationException,
    SingleSampleException,
    TimeoutException,
)
from tfbus.base.wording import near_names
from tfbus.buffer.buffer import Buffer
from tfbus.buffer.info import Change
from tfbus.geometry.batch import TransformBatch
from tfbus.geometry.sampling import Sampling
from tfbus.geometry.transform import Transform, TransformStamped


def turned(stamp_ns: int, parent: str, child: str, yaw: float) -> TransformStamped:
    return TransformStamped(stamp_ns, parent, child, Transform.from_rpy(0, 0, yaw))


def filled(*transforms: TransformStamped, cache_time_s: float = 10.0) -> Buffer:
    buffer = Buffer(cache_time_s)
    for transform in transforms:
        buffer.set_transform(transform, authority="tester")
    return buffer


def x_at(
    buffer: Buffer, stamp_ns: int | None, parent: str = "world", child: str = "robot"
) -> float:
    return buffer.lookup_transform(parent, child, stamp_ns).transform.x


# Reading one edge


def test_between_two_samples_the_answer_is_interpolated():
    """Half way in time between two samples the frame is half way in space."""
    buffer = filled(moved(100, "world", "robot", 1.0), moved(200, "world", "robot", 3.0))
    answer = buffer.lookup_transform("world", "robot", 150)
    assert answer.transform.x == 2.0
    assert (answer.stamp_ns, answer.frame_id, answer.child_frame_id) == (150, "world", "robot")
    assert buffer.lookup_transform("robot", "world", 150).transform.x == -2.0


def test_at_the_stamp_of_a_sample_the_answer_is_that_sample():
    """The first, the last and every sample between come out exactly as they went in."""
    samples = [turned(100 * i, "world", "robot", 0.7 * i) for i in range(5)]
    buffer = filled(*samples)
    for sample in samples:
        assert buffer.lookup_transform("world", "robot", sample.stamp_ns) == sample


@pytest.mark.parametrize(
    "stamps", [(0, 10, 20, 30), (0, 4, 20, 30), (0, 10, 14, 30), (4, 10, 20, 26)]
)
def test_edges_with_equal_counts_are_each_read_between_their_own_samples(stamps: tuple[int, ...]):
    """Each edge moves by its stamps, so that each of the two adds the time, whatever these are."""
    upper = [moved(stamp, "world", "robot", float(stamp)) for stamp in (0, 10, 20, 30)]
    lower = [moved(stamp, "robot", "arm", float(stamp)) for stamp in stamps]
    buffer = filled(*upper, *lower)
    for stamp_ns in (25, 24, 5, 15, 12, 13, 7, 22, 10, 25):
        assert x_at(buffer, stamp_ns, child="arm") == pytest.approx(2 * stamp_ns)


@settings(max_examples=examples(200))
@given(
    st.lists(
        st.tuples(
            st.sampled_from(["insert", "insert", "look up", "look up", "look up"]),
            st.integers(0, 12),
            st.sampled_from([("robot", "arm"), ("robot", "arm"), ("robot",), ("arm",)]),
        ),
        max_size=60,
    )
)
def test_a_path_is_read_as_its_edges_one_by_one(steps):
    """Whatever stamps the edges have in common, and whatever was looked up before."""
    above = {"robot": "world", "arm": "robot"}
    whole, alone = Buffer(), {frame: Buffer() for frame in above}
    for step, stamp_ns, frames in steps:
        if step == "insert":
            for frame in frames:
                sample = moved(stamp_ns, above[frame], frame, float(stamp_ns**2))
                whole.set_transform(sample)
                alone[frame].set_transform(sample)
        elif all(alone[frame].can_transform(above[frame], frame, stamp_ns) for frame in above):
            parts = [x_at(alone[frame], stamp_ns, above[frame], frame) for frame in above]
            assert x_at(whole, stamp_ns, child="arm") == pytest.approx(sum(parts))
        else:
            assert not whole.can_transform("world", "arm", stamp_ns)


def test_the_rotation_takes_the_short_way_round():
    """From 170 to 190 degrees a frame turns by 20, whatever the signs of the quaternions."""
    a, b = math.radians(170), math.radians(190)
    buffer = filled(turned(0, "world", "robot", a), turned(10, "world", "robot", b))
    flipped = Transform((0, 0, 0), -Transform.from_rpy(0, 0, b).quat_xyzw)
    other = filled(turned(0, "world", "robot", a), TransformStamped(10, "world", "robot", flipped))
    half_way = Transform.from_rpy(0, 0, math.pi)
    for either in (buffer, other):
        assert either.lookup_transform("world", "robot", 5).transform.is_close(half_way, 1e-12)


@given(st.floats(-3.1, 3.1), st.floats(0.0, 1.0))
def test_a_turn_is_interpolated_at_even_speed(angle, ratio):
    """Slerp: after a part of the time a frame has turned by that part of the angle."""
    end = 1_000_000
    buffer = filled(turned(0, "world", "robot", 0.3), turned(end, "world", "robot", 0.3 + angle))
    stamp = round(end * ratio)
    expected = Transform.from_rpy(0, 0, 0.3 + angle * stamp / end)
    assert buffer.lookup_transform("world", "robot", stamp).transform.is_close(expected, 1e-12)


@settings(max_examples=examples(60))
@given(st.lists(st.integers(0, 300), min_size=2, max_size=80), st.randoms())
def test_the_order_of_arrival_does_not_matter(stamps, random):
    """Whatever the order in which samples came, the answers are the same."""
    stamps = sorted(set(stamps))
    samples = [moved(stamp, "world", "robot", float(stamp**2)) for stamp in stamps]
    in_order = filled(*samples)
    shuffled = list(samples)
    random.shuffle(shuffled)
    buffer = filled(*shuffled)
    for stamp in range(stamps[0], stamps[-1] + 1):
        assert x_at(buffer, stamp) == x_at(in_order, stamp)
        right = np.interp(stamp, stamps, [s**2 for s in stamps])
        assert x_at(buffer, stamp) == pytest.approx(right) or len(stamps) == 1


def test_equal_stamps_the_latest_arrival_wins_and_is_counted():
    """A sample that repeats a stamp replaces the former; a different value is a conflict."""
    buffer = filled(moved(100, "world", "robot", 1.0), moved(200, "world", "robot", 3.0))
    buffer.set_transform(moved(200, "world", "robot", 3.0))
    assert buffer.frame("robot").conflicts == 0
    buffer.set_transform(moved(200, "world", "robot", 5.0))
    assert x_at(buffer, 200) == 5.0
    assert buffer.frame("robot").conflicts == 1
    assert buffer.frame("robot").samples == 2


def test_edges_that_have_no_time_in_common_are_named():
    """Where one edge ended before what is kept of another, a lookup of the latest says which."""
    buffer = filled(
        moved(1 * S, "world", "robot", 0.0),
        moved(2 * S, "world", "robot", 0.0),
        moved(10 * S, "world", "camera", 0.0),
        cache_time_s=1.0,
    )
    with pytest.raises(ExtrapolationException) as caught:
        buffer.lookup_transform("robot", "camera")
    error = caught.value
    assert (error.frame_id, error.child_frame_id, error.authority) == ("world", "robot", "tester")
    assert (error.newest_ns, error.advice_by) == (2 * S, "cache_time_s")
    assert error.waiting
    assert "8.000 s earlier" in error.fact and "oldest of 'camera'" in error.fact
    buffer.set_transform(moved(10 * S, "world", "robot", 0.0))
    assert buffer.lookup_transform("robot", "camera").stamp_ns == 10 * S


def test_what_is_older_than_the_cache_is_refused_and_counted():
    """A sample older than the newest by more than the cache time is not kept; one as old is."""
    buffer = filled(moved(20 * S, "world", "robot", 1.0), cache_time_s=10.0)
    assert not buffer.set_transform(moved(10 * S - 1, "world", "robot", 0.0))
    assert buffer.set_transform(moved(10 * S, "world", "robot", 0.0))
    assert buffer.frame("robot").refused == 1
    assert buffer.frame("robot").samples == 2


def test_old_samples_leave_as_new_ones_come():
    """The history holds at most the cache time, however long samples come."""
    buffer = Buffer(1.0)
    for i in range(5000):
        buffer.set_transform(moved(i * S // 100, "world", "robot", float(i)))
    info = buffer.frame("robot")
    assert (info.samples, info.newest_ns - info.oldest_ns) == (101, S)
    assert info.rate_hz == pytest.approx(100.0)
    assert x_at(buffer, info.oldest_ns) == 4899.0


def test_latest_is_the_latest_common_time_of_the_path():
    """Without a stamp the answer is of the newest time that every edge has come to."""
    buffer = filled(
        moved(0, "world", "robot", 0.0),
        moved(1000, "world", "robot", 10.0),
        moved(0, "robot", "arm", 0.0),
        moved(500, "robot", "arm", 1.0),
    )
    assert buffer.latest_common_time("world", "arm") == 500
    answer = buffer.lookup_transform("world", "arm")
    assert (answer.stamp_ns, answer.transform.x) == (500, 6.0)


def test_the_stamp_zero_is_a_time_like_any_other():
    """Time 0 asks for time 0, not for the latest; times before 1970 are times too."""
    buffer = filled(*(moved(stamp, "world", "robot", float(stamp)) for stamp in (-100, 0, 100)))
    assert x_at(buffer, 0) == 0.0
    assert x_at(buffer, -50) == -50.0
    assert x_at(buffer, None) == 100.0


# The tree


def test_a_lookup_goes_up_to_the_common_ancestor_and_down_again():
    """The hand seen from the camera is the way up from the hand and down to the camera."""
    buffer = filled(
        *(
            TransformStamped(stamp, parent, child, Transform((x, y, 0)))
            for stamp in (0, 100)
            for parent, child, x, y in (
                ("world", "robot", 10, 0),
                ("robot", "arm", 1, 0),
                ("arm", "hand", 0, 1),
                ("robot", "camera", 0, 2),
            )
        )
    )
    answer = buffer.lookup_transform("camera", "hand", 50).transform
    assert answer.xyz.tolist() == [1.0, -1.0, 0.0]
    assert buffer.path("camera", "hand") == ["hand", "arm", "robot", "camera"]
    assert buffer.path("world", "hand") == ["hand", "arm", "robot", "world"]
    assert buffer.path("hand", "world") == ["world", "robot", "arm", "hand"]
    assert buffer.path("hand", "hand") == ["hand"]


def test_an_edge_above_the_common_ancestor_is_never_read():
    """That the world has no data for a time does not matter between two parts of the robot."""
    buffer = filled(
        moved(900, "world", "robot", 0.0),
        *(moved(s, "robot", c, 1.0) for s in (0, 100) for c in ("left", "right")),
    )
    assert x_at(buffer, 50, "left", "right") == 0.0
    with pytest.raises(ExtrapolationException) as caught:
        buffer.lookup_transform("world", "left", 50)
    assert caught.value.child_frame_id == "robot"


def test_a_frame_seen_from_itself_is_the_identity():
    """The same frame twice is the identity, at any time, but its name is checked."""
    buffer = filled(moved(100, "world", "robot", 1.0))
    answer = buffer.lookup_transform("robot", "robot", 5)
    assert answer.transform == Transform.identity()
    assert answer.stamp_ns == 5
    with pytest.raises(LookupException):
        buffer.lookup_transform("nobody", "nobody")


def test_history_survives_a_change_of_parent():
    """Before a frame was handed over it hangs where it hung then; after, where it hangs now."""
    buffer = filled(
        moved(0, "world", "table", 5.0),
        moved(1000, "world", "table", 5.0),
        moved(0, "world", "gripper", 1.0),
        moved(1000, "world", "gripper", 2.0),
        moved(0, "table", "cup", 0.0),
        moved(400, "table", "cup", 0.0),
        moved(600, "gripper", "cup", 0.0),
        moved(1000, "gripper", "cup", 0.0),
    )
    assert x_at(buffer, 200, "world", "cup") == 5.0
    assert x_at(buffer, 500, "world", "cup") == 5.0  # between two parents: the older sample
    assert x_at(buffer, 800, "world", "cup") == pytest.approx(1.8)
    assert buffer.frame("cup").parent == "gripper"


def test_an_edge_that_would_close_a_loop_is_refused():
    """The error names both publishers, and nothing has changed."""
    buffer = Buffer()
    buffer.set_transform(moved(0, "a", "b", 1.0), authority="alice")
    buffer.set_transform(moved(0, "b", "c", 1.0), authority="bob")
    with pytest.raises(LoopException, match=r"'carol'.*'alice'") as caught:
        buffer.set_transform(moved(0, "c", "a", 1.0), authority="carol")
    assert caught.value.path == ("c", "b", "a")
    assert (caught.value.authority, caught.value.other_authority) == ("carol", "alice")
    assert buffer.frame("a").parent is None
    with pytest.raises(InvalidArgumentException, match="own parent"):
        buffer.set_transform(moved(0, "a", "a", 1.0))


def test_a_frame_is_seen_from_itself_and_never_its_own_parent():
    """A lookup of a frame from itself has an answer, which no buffer takes as an edge."""
    buffer = filled(moved(100, "world", "robot", 1.0))
    answer = buffer.lookup_transform("robot", "robot")
    assert (answer.frame_id, answer.child_frame_id) == ("robot", "robot")
    with pytest.raises(InvalidArgumentException, match="own parent"):
        buffer.set_transform(answer)


def test_static_frames_hold_at_all_times():
    """A static transform answers at any time, and does not hold back the latest one."""
    buffer = filled(moved(100, "world", "robot", 1.0), moved(200, "world", "robot", 2.0))
    buffer.set_transform(moved(7, "robot", "camera", 0.5), static=True)
    assert x_at(buffer, 10**15, "robot", "camera") == 0.5
    assert x_at(buffer, 150, "world", "camera") == 2.0
    assert buffer.latest_common_time("world", "camera") == 200
    assert buffer.latest_common_time("robot", "camera") is None
    assert buffer.lookup_transform("robot", "camera").stamp_ns == 0


def test_a_frame_that_turns_static_keeps_its_history():
    """When it turns dynamic again, the samples of before are still there."""
    buffer = filled(moved(100, "world", "robot", 1.0), moved(200, "world", "robot", 2.0))
    buffer.set_transform(moved(300, "world", "robot", 9.0), static=True)
    assert x_at(buffer, 150) == 9.0
    assert buffer.frame("robot").static
    buffer.set_transform(moved(300, "world", "robot", 3.0))
    assert x_at(buffer, 150) == 1.5
    assert not buffer.frame("robot").static


def test_clear_keeps_static_frames_and_names():
    """After clear() the samples are gone, the static transforms are not."""
    buffer = filled(moved(100, "world", "robot", 1.0), moved(200, "world", "robot", 2.0))
    buffer.set_transform(moved(0, "robot", "camera", 0.5), static=True)
    buffer.clear()
    assert x_at(buffer, 5, "robot", "camera") == 0.5
    assert buffer.frames() == ["camera", "robot", "world"]
    with pytest.raises(NoDataException):
        buffer.lookup_transform("world", "robot")
    buffer.set_transform(moved(1, "robot", "world", 4.0))
    assert x_at(buffer, 1, "robot", "world") == 4.0


def test_a_removed_frame_is_forgotten():
    """What hung below it hangs there still; it is a root, or gone if nothing does."""
    buffer = filled(moved(1, "world", "robot", 1.0), moved(1, "robot", "arm", 1.0))
    buffer.remove("robot")
    assert buffer.frame("robot").parent is None
    assert x_at(buffer, 1, "robot", "arm") == 1.0
    with pytest.raises(ConnectivityException):
        buffer.lookup_transform("world", "arm")
    buffer.remove("arm")
    assert buffer.frames() == ["robot", "world"]
    with pytest.raises(LookupException):
        buffer.remove("arm")


def test_time_travel_goes_through_a_fixed_frame():
    """Where the robot was five seconds ago, seen from where it is now."""
    buffer = filled(*(moved(i * S, "world", "robot", float(i * i)) for i in range(11)))
    answer = buffer.lookup_transform_full("robot", 10 * S, "robot", 5 * S, "world")
    assert answer.transform.x == -75.0
    assert (answer.stamp_ns, answer.frame_id, answer.child_frame_id) == (10 * S, "robot", "robot")


# Errors


def test_an_error_carries_the_facts_and_the_remedy():
    """Past and future are classes of their own, with edge, stamps, publisher and a hint."""
    buffer = filled(*(moved(i * S, "world", "robot", 0.0) for i in range(3)))
    buffer.set_transform(moved(0, "robot", "camera", 0.5), static=True)
    with pytest.raises(PastExtrapolationException) as past:
        buffer.lookup_transform("world", "camera", -1)
    with pytest.raises(FutureExtrapolationException, match=r"'tester'.*wait about 2 s") as future:
        buffer.lookup_transform("world", "camera", 3 * S + 1)
    for error in (past.value, future.value):
        assert (error.frame_id, error.child_frame_id) == ("world", "robot")
        assert (error.oldest_ns, error.newest_ns, error.authority) == (0, 2 * S, "tester")
    assert (past.value.requested_ns, past.value.retry_after_s) == (-1, None)
    assert future.value.retry_after_s == 2.0


def test_one_sample_answers_for_its_own_time_only():
    """With one sample there is nothing to interpolate: another time is a kind of its own."""
    buffer = filled(moved(100, "world", "robot", 1.0))
    assert x_at(buffer, 100) == 1.0
    for stamp, remedy in ((99, "1 ns later; query a later time"), (101, "wait for another")):
        with pytest.raises(SingleSampleException, match=remedy):
            buffer.lookup_transform("world", "robot", stamp)


def test_no_lookup_waits_for_what_lies_before_the_only_sample():
    """Older samples do not come: a lookup that would wait fails at once."""
    buffer = filled(moved(1000 * S, "world", "robot", 1.0))
    with pytest.raises(SingleSampleException, match=r"995\.000 s later; query a later"):
        buffer.lookup_transform("world", "robot", 5 * S, timeout_s=30.0)


def test_an_unknown_frame_brings_the_nearest_names():
    """A name mistyped is answered with the names that look like it."""
    buffer = filled(moved(1, "world", "base_link", 1.0), moved(1, "base_link", "arm", 1.0))
    with pytest.raises(LookupException, match="'base_link'") as caught:
        buffer.lookup_transform("world", "base_lnk")
    assert (caught.value.frame, caught.value.nearest) == ("base_lnk", ("base_link",))
    with pytest.raises(LookupException, match="no frame is known"):
        Buffer().lookup_transform("a", "b")


@pytest.mark.parametrize("name", ["", "x"])
def test_among_many_frames_any_name_may_be_unknown(name):
    """Also an empty one, which has no first letter to compare."""
    buffer = Buffer()
    for number in range(1001):
        buffer.set_transform(moved(0, "world", f"frame{number}"), static=True)
    for call in (buffer.remove, buffer.frame):
        with pytest.raises(LookupException, match=f"no frame '{name}'; available: "):
            call(name)


def test_among_many_frames_each_has_its_own_answer():
    """Whichever was looked up before: paths that are used again are kept by their names."""
    frames = {f"frame{number}": float(number) for number in range(300)}
    buffer = filled(*(moved(1, "world", name, x) for name, x in frames.items()))
    for _ in range(3):
        found = {name: buffer.lookup_transform("world", name).transform.x for name in frames}
        back = {name: -buffer.lookup_transform(name, "world").transform.x for name in frames}
        assert found == back == frames


def test_names_are_compared_when_an_error_is_read(monkeypatch):
    """To compare many names takes long: an error that is dropped costs none of it."""
    buffer = filled(moved(1, "world", "robot", 1.0))
    compared = []

    def compare(frame, known):
        compared.append(frame)
        return near_names(frame, known)

    monkeypatch.setattr("tfbus.base.errors.near_names", compare)
    for timeout_s in (0.0, 1e-3):
        with pytest.raises((LookupException, TimeoutException)) as raised:
            buffer.lookup_transform("world", "robt", timeout_s=timeout_s)
        assert compared == []
        assert "did you mean 'robot'?" in str(raised.value)
        assert compared.pop() == "robt"


def test_two_trees_are_not_connected():
    """The error names both roots."""
    buffer = filled(moved(1, "world", "robot", 1.0), moved(1, "moon", "rover", 1.0))
    with pytest.raises(ConnectivityException) as caught:
        buffer.lookup_transform("robot", "rover")
    assert (caught.value.target_root, caught.value.source_root) == ("world", "moon")


@pytest.mark.parametrize("name", ["", "/robot", 7, None])
def test_a_name_that_cannot_be_is_refused_alike_everywhere(name):
    """A frame id is not empty and has no leading slash, on insert as on lookup."""
    buffer = filled(moved(1, "world", "robot", 1.0))
    with pytest.raises(InvalidArgumentException):
        buffer.lookup_transform("world", name)
    with pytest.raises(InvalidArgumentException):
        TransformStamped(1, "world", name, Transform())
    assert not buffer.can_transform("world", name)


@pytest.mark.parametrize("stamp", [1.5, "now", 2**63, -(2**70)])
def test_a_stamp_that_cannot_be_is_refused(stamp):
    """A stamp is a whole number of nanoseconds that fits."""
    buffer = filled(moved(1, "world", "robot", 1.0))
    with pytest.raises(InvalidArgumentException):
        buffer.lookup_transform("world", "robot", stamp)


@pytest.mark.parametrize("stamp", [2**63, -(2**63), -(2**70)])
def test_a_stamp_that_cannot_be_is_refused_between_two_trees(stamp):
    """The error is that of the stamp, as between frames that are joined."""
    buffer = filled(moved(1, "world", "robot", 1.0), moved(1, "map", "cart", 1.0))
    with pytest.raises(InvalidArgumentException, match="stamp"):
        buffer.lookup_transform("world", "cart", stamp)


def test_numpy_integers_are_stamps_too():
    """A stamp out of an array works as it is."""
    buffer = filled(moved(1, "world", "robot", 1.0), moved(3, "world", "robot", 2.0))
    answer = buffer.lookup_transform("world", "robot", np.int64(2))
    assert (answer.stamp_ns, type(answer.stamp_ns)) == (2, int)


def test_can_transform_answers_yes_or_no():
    """It is true where lookup_transform answers, and never raises."""
    buffer = filled(moved(1, "world", "robot", 1.0), moved(3, "world", "robot", 2.0))
    assert buffer.can_transform("world", "robot", 2)
    assert not buffer.can_transform("world", "robot", 4)
    assert not buffer.can_transform("world", "nobody")


# Sampling


def test_an_answer_by_former_parents_says_how_far_it_is_extrapolated():
    """Not at all between samples, also where the frame has another parent by now."""
    bold = Sampling(extrapolation_s=2.0)
    buffer = filled(
        *(moved(i * S, "map", "base", float(i)) for i in (0, 1, 2)),
        *(moved(i * S, "odom", "base", float(i)) for i in (5, 6)),
        *(moved(i * S, "base", "arm", 1.0) for i in (0, 1, 2, 5, 6)),
    )
    for stamp_ns, extrapolated_ns in ((S, 0), (-S, S)):
        answer = buffer.lookup_transform("map", "arm", stamp_ns, sampling=bold)
        assert answer.transform.x == pytest.approx(stamp_ns / S + 1)
        assert answer.extrapolated_ns == extrapolated_ns


def test_extrapolation_is_bounded_and_marked():
    """Beyond the last samples a frame goes on at their twist, as far as was allowed."""
    circle = [
        TransformStamped(
            i * S,
            "world",
            "robot",
            Transform.from_rpy(0, 0, 0.1 * i, (math.sin(0.1 * i), -math.cos(0.1 * i), 0)),
        )
        for i in range(3)
    ]
    buffer = filled(*circle)
    bold = Sampling(extrapolation_s=2.0)
    answer = buffer.lookup_transform("world", "robot", 4 * S, sampling=bold)
    expected = Transform.from_rpy(0, 0, 0.4, (math.sin(0.4), -math.cos(0.4), 0))
    assert answer.transform.is_close(expected, 1e-12)
    assert answer.extrapolated_ns == 2 * S
    assert buffer.lookup_transform("world", "robot", S, sampling=bold).extrapolated_ns == 0
    before = buffer.lookup_transform("world", "robot", -S, sampling=bold)
    assert before.transform.is_close(
        Transform.from_rpy(0, 0, -0.1, (math.sin(-0.1), -math.cos(-0.1), 0)), 1e-12
    )
    for stamp in (4 * S + 1, -2 * S - 1):
        with pytest.raises(ExtrapolationException):
            buffer.lookup_transform("world", "robot", stamp, sampling=bold)
    with pytest.raises(FutureExtrapolationException):
        buffer.lookup_transform("world", "robot", 4 * S)


def test_a_screw_keeps_a_circle_round():
    """Between two samples on a circle "screw" stays on it; "linear" cuts the corner."""
    quarter = Transform.from_rpy(0, 0, math.pi / 2, (0, 1, 0))
    start = Transform((1, 0, 0))
    samples = (
        TransformStamped(0, "world", "robot", start),
        TransformStamped(100, "world", "robot", quarter),
    )
    half = math.sqrt(0.5)
    screw = Buffer(sampling=Sampling("screw"))
    for sample in samples:
        screw.set_transform(sample)
    assert np.allclose(
        screw.lookup_transform("world", "robot", 50).transform.xyz, (half, half, 0), atol=1e-12
    )
    linear = filled(*samples).lookup_transform("world", "robot", 50).transform
    assert np.allclose(linear.xyz, (0.5, 0.5, 0))


def test_the_nearest_sample_within_a_tolerance():
    """Nearest takes a sample as it is, where it is near enough."""
    buffer = filled(moved(100, "world", "robot", 1.0), moved(200, "world", "robot", 3.0))
    near = Sampling("nearest", tolerance_s=40e-9)

    def x(stamp: int) -> float:
        return buffer.lookup_transform("world", "robot", stamp, sampling=near).transform.x

    assert [x(60), x(140), x(160), x(240)] == [1.0, 1.0, 3.0, 3.0]
    for stamp in (59, 150, 241):
        with pytest.raises(ExtrapolationException):
            x(stamp)


def test_a_nearest_sample_is_never_extrapolated():
    """Also if the lookup before it was."""
    buffer = filled(moved(100, "world", "robot", 1.0), moved(200, "world", "robot", 3.0))
    beyond = Sampling(extrapolation_s=1.0)
    assert buffer.lookup_transform("world", "robot", 240, sampling=beyond).extrapolated_ns == 40
    nearest = Sampling("nearest", tolerance_s=1.0)
    assert buffer.lookup_transform("world", "robot", 200, sampling=nearest).extrapolated_ns == 0


def test_sampling_is_checked_when_made():
    """An impossible choice is refused with what is possible."""
    with pytest.raises(InvalidArgumentException, match="'screw'"):
        Sampling("cubic")
    with pytest.raises(InvalidArgumentException):
        Sampling(extrapolation_s=-1.0)
    with pytest.raises(InvalidArgumentException):
        Sampling("nearest", extrapolation_s=1.0)
    with pytest.raises(InvalidArgumentException, match='only for interpolation="nearest"'):
        Sampling(tolerance_s=1.0)
    assert Sampling(extrapolation_s=1e6).extrapolation_s == 1e6
    with pytest.raises(InvalidArgumentException, match="from 0 to 1e6, not 1000001"):
        Sampling(extrapolation_s=1_000_001)


# Changes


def test_a_frame_that_was_never_dynamic_does_not_become_static():
    """It is added, and sent again nothing changes."""
    kinds: list[str] = []
    buffer = Buffer()
    buffer.on_change(lambda change: kinds.append(change.kind))
    for _ in range(2):
        buffer.set_transform(moved(S, "world", "lamp"), static=True)
    assert kinds == ["added", "added"]


def test_listeners_are_told_of_every_change():
    """Added, reparented, static, dynamic, conflict, too old, removed: each with who did it; a
    new parent before the frames that move to it.
    """
    heard: list[Change] = []
    buffer = Buffer(1.0)
    end = buffer.on_change(heard.append)
    buffer.set_transform(moved(5 * S, "world", "robot", 1.0), authority="alice")
    buffer.set_transform(moved(5 * S, "world", "robot", 2.0), authority="bob")
    buffer.set_transform(moved(1 * S, "world", "robot", 2.0), authority="carol")
    buffer.set_transform(moved(6 * S, "map", "robot", 2.0), authority="dave")
    buffer.set_transform(moved(6 * S, "map", "robot", 2.0), static=True, authority="erin")
    buffer.set_transform(moved(7 * S, "map", "robot", 3.0), authority="dave")
    buffer.remove("robot")
    assert [(c.kind, c.frame) for c in heard] == [
        ("added", "world"),
        ("added", "robot"),
        ("conflict", "robot"),
        ("too old", "robot"),
        ("added", "map"),
        ("reparented", "robot"),
        ("became static", "robot"),
        ("became dynamic", "robot"),
        ("removed", "robot"),
    ]
    assert (heard[2].authority, heard[2].former_authority) == ("bob", "alice")
    assert (heard[5].former_parent, heard[5].parent) == ("world", "map")
    end()
    buffer.set_transform(moved(7 * S, "map", "other", 2.0))
    assert len(heard) == 9


# Columns in


def test_a_batch_is_taken_row_by_row():
    """A bad row harms none of the others and is counted by its reason."""
    good = [moved(i, "world", f"robot{i}", float(i)) for i in range(4)]
    batch = TransformBatch.from_transforms(good)
    poses = batch.poses.copy()
    poses[1, 0] = math.nan
    poses[2, 6] = 0.5
    bad = TransformBatch(batch.frames, batch.edges, batch.stamps_ns, poses)
    buffer = Buffer()
    assert buffer.set_transforms(bad, authority="tester") == 2
    assert buffer.frames() == ["robot0", "robot3", "world"]
    assert sum(buffer.rejected.values()) == 2
    assert buffer.frame("robot3").authority == "tester"


def test_a_batch_and_single_transforms_make_the_same_buffer():
    """It makes no difference whether transforms come one by one or in columns."""
    some = [turned(100 * i, "world", f"r{i % 3}", 0.1 * i) for i in range(30)]
    one_by_one, at_once = filled(*some), Buffer()
    at_once.set_transforms(TransformBatch.from_transforms(some))
    for stamp in range(200, 2700, 70):
        for child in ("r0", "r1", "r2"):
            a = one_by_one.lookup_transform("world", child, stamp)
            assert a.transform == at_once.lookup_transform("world", child, stamp).transform


@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (-0.6, 0.0, 0.8)])
def test_a_turn_about_any_axis_is_taken(axis: tuple[float, float, float]) -> None:
    """It comes out of the buffer as it was, alone or in a batch."""
    turn = Transform.from_rotvec(tuple(1.3 * each for each in axis), (1, 2, 3))
    row = TransformStamped(1, "a", "b", turn)
    for rows in ([row], TransformBatch.from_transforms([row, row])):
        buffer = Buffer()
        assert buffer.set_transforms(rows) == len(rows)
        assert buffer.lookup_transform("a", "b").transform.is_close(turn)


def test_a_quaternion_within_tolerance_is_normalised():
    """tf2's tolerance: slightly off is made right, more is refused."""
    edges, stamps = np.array([[0, 1]], np.uint32), np.array([1])
    batch = TransformBatch(("a", "b"), edges, stamps, np.array([[0, 0, 0, 0, 0, 0, 1.004]]))
    buffer = Buffer()
    assert buffer.set_transforms(batch) == 1
    assert buffer.lookup_transform("a", "b").transform.qw == 1.0
    with pytest.raises(InvalidArgumentException, match="norm"):
        Transform((0, 0, 0), (0, 0, 0, 1.006))


def test_the_reasons_of_rejections_have_an_end() -> None:
    """Whatever names come from the bus, at most 100 reasons are kept; the rest is counted."""
    buffer = Buffer()
    for at in range(150):
        loop = TransformStamped(1, f"frame{at}", f"frame{at + 1}", Transform())
        back = TransformStamped(1, f"frame{at + 1}", f"frame{at}", Transform())
        buffer.set_transforms(TransformBatch.from_transforms([loop, back]))
    assert buffer.rejected.total() == 150
    assert len(buffer.rejected) == 101
    assert buffer.rejected["other reasons"] == 50
    assert "frame150" in buffer.rejected.last
