"""Arguments of a wrong type or out of range: one sentence that names the right type or range."""

import asyncio
import math
from decimal import Decimal
from enum import StrEnum
from typing import Any

import numpy as np
import pytest

from tests.builders import S, moved
from tfbus.base.errors import InvalidArgumentException, LookupException
from tfbus.buffer import trajectories
from tfbus.buffer.buffer import Buffer
from tfbus.geometry.batch import TransformBatch
from tfbus.geometry.kernel import LONGEST_NS
from tfbus.geometry.sampling import Sampling
from tfbus.geometry.transform import Transform, TransformStamped
from tfbus.streams.sender import StreamOptions


class Frame(StrEnum):
    """Names as a program may list them."""

    WORLD = "world"
    ROBOT = "robot"


class Forgetful(Buffer):
    """A subclass that does not call `super().__init__()`."""

    def __init__(self, name: str) -> None:
        self.name = name


def filled() -> Buffer:
    """A robot that stands still for three seconds."""
    buffer = Buffer()
    for i in range(4):
        buffer.set_transform(moved(i * S, "world", "robot"))
    return buffer


ANY: Any = None
NOT_SECONDS = [math.nan, "1", None, object()]


@pytest.mark.parametrize("wrong", [None, 1, "robot", Transform()])
def test_only_stamped_transforms_are_stored(wrong: Any):
    """The one that is wanted is named."""
    with pytest.raises(InvalidArgumentException, match=r"expected a tfbus\.TransformStamped"):
        Buffer().set_transform(wrong)


@pytest.mark.parametrize("wrong", [None, 1, "robot", moved(0, "world", "robot"), [None], [1]])
def test_only_batches_and_several_transforms_are_stored_at_once(wrong: Any):
    """One transform is not several."""
    with pytest.raises(InvalidArgumentException, match=r"expected (a )?tfbus\.Transform"):
        Buffer().set_transforms(wrong)


def test_several_transforms_are_stored_at_once():
    """A list or a generator of them is as good as a batch."""
    buffer = Buffer()
    assert buffer.set_transforms([moved(0, "world", "robot"), moved(0, "world", "arm")]) == 2
    assert buffer.set_transforms(moved(i, "world", "robot") for i in (1, 2)) == 2
    assert buffer.frame("robot").samples == 3


@pytest.mark.parametrize("wrong", [None, 1, "robot"])
def test_only_transforms_are_between_others(wrong: Any):
    """Anything else would be read as memory."""
    for call in (
        lambda: Transform().interpolate(wrong, 0.5),
        lambda: Transform().interpolate_screw(wrong, 0.5),
        lambda: Transform().is_close(wrong),
        lambda: TransformStamped(0, "world", "robot", wrong),
    ):
        with pytest.raises(InvalidArgumentException, match=r"expected a tfbus\.Transform"):
            call()


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda buffer: buffer.frame(None), "name must be a str, not NoneType"),
        (lambda buffer: trajectories.samples(buffer, None), "frame must be a str, not NoneType"),
        (
            lambda buffer: trajectories.samples(buffer, "robot", parent=[]),
            "parent must be a str, not list",
        ),
        (
            lambda buffer: trajectories.insert(buffer, None),
            r"expected a tfbus\.Trajectory, got a None",
        ),
        (
            lambda buffer: trajectories.insert(buffer, [1]),
            r"expected a tfbus\.Trajectory, got a list",
        ),
        (lambda buffer: buffer.on_change(3), r"a function of a tfbus\.Change, not int"),
        (lambda buffer: buffer.clear(after_ns=1.5), r"must be an integer, nanosec.*, not 1\.5"),
        (lambda buffer: Sampling(extrapolation_s=ANY), "extrapolation_s must be a number"),
        (lambda buffer: Sampling(extrapolation_s="1"), "extrapolation_s must be a number"),
        (lambda buffer: StreamOptions(priority="high"), "must be a 32-bit integer, not 'high'"),
        (lambda buffer: StreamOptions(priority=1.5), r"must be a 32-bit integer, not 1\.5"),
        (lambda buffer: StreamOptions(history_s="1"), "history_s must be a number of seconds"),
    ],
)
def test_an_argument_of_another_type_is_named(call: Any, says: str):
    """In one sentence, and nothing has changed."""
    buffer = filled()
    with pytest.raises(InvalidArgumentException, match=says):
        call(buffer)
    assert buffer.frame("robot").samples == 4


def test_a_subclass_may_forget_its_base():
    """Then it has the defaults."""
    buffer = Forgetful("mine")
    assert buffer.set_transform(moved(0, "world", "robot"))
    assert buffer.lookup_transform("world", "robot").stamp_ns == 0
    assert (buffer.cache_time_s, buffer.sampling, buffer.frames()) == (
        10.0,
        Sampling(),
        ["robot", "world"],
    )


@pytest.mark.parametrize("wrong", [*NOT_SECONDS, -1.0])
def test_the_cache_time_is_a_number_of_seconds(wrong: Any):
    """A node, say, is not one."""
    with pytest.raises(InvalidArgumentException, match=r"cache_time_s .*number"):
        Buffer(wrong)


@pytest.mark.parametrize("wrong", NOT_SECONDS)
def test_a_timeout_is_a_number_of_seconds(wrong: Any):
    """NaN would never pass."""
    buffer = filled()
    with pytest.raises(InvalidArgumentException, match=r"timeout_s .*number"):
        buffer.lookup_transform("world", "robot", 9 * S, timeout_s=wrong)
    with pytest.raises(InvalidArgumentException, match=r"timeout_s .*number"):
        buffer.can_transform("world", "robot", 9 * S, timeout_s=wrong)


@pytest.mark.parametrize("wrong", NOT_SECONDS)
def test_a_wrong_timeout_is_noticed_where_nothing_waits(wrong: Any):
    """Else it would fail on the first day that a transform comes late."""
    buffer = filled()
    with pytest.raises(InvalidArgumentException, match=r"timeout_s .*number"):
        buffer.lookup_transform("world", "robot", timeout_s=wrong)


@pytest.mark.parametrize("wrong", [math.nan, "1", object()])
def test_a_wrong_timeout_of_a_coroutine_is_noticed_at_once(wrong: Any):
    """None is for ever there."""
    with pytest.raises(InvalidArgumentException, match=r"timeout_s .*number"):
        asyncio.run(filled().wait_for_transform("world", "robot", timeout_s=wrong))


@pytest.mark.parametrize("right", [0, 0.0, 1, 2.5, -1.0, math.inf, np.float32(0.5)])
def test_a_number_of_seconds_changes_no_answer_that_is_there(right: Any):
    """A negative one is of a deadline that has passed: it does not wait."""
    buffer = filled()
    answer = buffer.lookup_transform("world", "robot")
    assert buffer.lookup_transform("world", "robot", timeout_s=right) == answer


@pytest.mark.parametrize("wrong", [*NOT_SECONDS, math.inf, 0.0, -1.0])
def test_a_window_is_a_number_of_seconds(wrong: Any):
    """From a nanosecond to all that stamps can say."""
    with pytest.raises(InvalidArgumentException, match=r"window_s .*number"):
        filled().lookup_twist("robot", "world", window_s=wrong)
    longest = filled().lookup_twist("robot", "world", window_s=LONGEST_NS / 1e9)
    assert longest.linear.tolist() == [0, 0, 0]


@pytest.mark.parametrize("wrong", ["1", -1.0, math.nan])
def test_an_age_is_a_number_of_seconds(wrong: Any):
    """None, and only None, means any age."""
    with pytest.raises(InvalidArgumentException, match=r"max_age_s .*number"):
        filled().lookup_transform("world", "robot", max_age_s=wrong)


@pytest.mark.parametrize("wrong", ["nearest", 1])
def test_a_sampling_is_a_sampling(wrong: Any):
    """Its name is not enough."""
    with pytest.raises(InvalidArgumentException, match=r"expected a tfbus\.Sampling"):
        Buffer(sampling=wrong)
    buffer = filled()
    for call in (
        lambda: buffer.lookup_transform("world", "robot", sampling=wrong),
        lambda: buffer.can_transform("world", "robot", sampling=wrong),
        lambda: buffer.lookup_transform_full("world", 0, "robot", 0, "world", sampling=wrong),
        lambda: buffer.lookup_transforms("world", "robot", [0], sampling=wrong),
        lambda: buffer.lookup_known_transforms("world", "robot", [0], sampling=wrong),
    ):
        with pytest.raises(InvalidArgumentException, match=r"expected a tfbus\.Sampling"):
            call()


def test_the_seconds_of_a_sampling_are_any_number():
    """As one that is read from a file without rounding."""
    tenth = Sampling(extrapolation_s=Decimal("0.1"))  # type: ignore[arg-type]
    assert filled().can_transform("world", "robot", sampling=tenth)
    assert tenth == Sampling(extrapolation_s=0.1)


def test_a_clock_is_callable():
    """At the start and when it is set."""
    with pytest.raises(InvalidArgumentException, match="clock must be callable"):
        Buffer(clock=ANY)
    with pytest.raises(InvalidArgumentException, match="clock must be callable"):
        Buffer().clock = ANY


@pytest.mark.parametrize(
    "stamps",
    [
        np.array([2**63 + 5], dtype=np.uint64),
        np.array([1, 2], dtype="m8[ns]"),
        np.ma.array([1, 2], mask=[False, True]),
        [1.0],
    ],
    ids=["uint64", "timedelta64", "masked", "float"],
)
def test_stamps_are_integers_that_fit(stamps: Any):
    """None of them is misread."""
    with pytest.raises(InvalidArgumentException, match="stamp"):
        filled().lookup_transforms("world", "robot", stamps)
    count = len(stamps)
    edges, poses = [(0, 1)] * count, [(0, 0, 0, 0, 0, 0, 1)] * count
    with pytest.raises(InvalidArgumentException, match="stamps_ns"):
        TransformBatch(("world", "robot"), np.array(edges, np.uint32), stamps, np.array(poses))


def test_stamps_without_a_sign_are_stamps():
    """As far as they fit."""
    answers = filled().lookup_transforms("world", "robot", np.array([S, 2 * S], dtype=np.uint64))
    assert len(answers.xyz) == 2


@pytest.mark.parametrize(
    "wrong", [np.timedelta64(5, "ns"), np.ma.masked, np.ma.array(5, mask=True), 2**63, "5", 5.0]
)
def test_one_stamp_is_an_integer_that_fits(wrong: Any):
    """The same holds for one."""
    with pytest.raises(InvalidArgumentException, match="stamp"):
        filled().lookup_transform("world", "robot", wrong)
    with pytest.raises(InvalidArgumentException, match="stamp"):
        TransformStamped(wrong, "world", "robot", Transform())


@pytest.mark.parametrize(
    ("world", "robot"),
    [(Frame.WORLD, Frame.ROBOT), (np.str_("world"), np.str_("robot"))],
    ids=["StrEnum", "numpy"],
)
def test_names_may_be_of_a_subclass_of_str(world: Any, robot: Any):
    """They are kept as what they say."""
    buffer = Buffer()
    stamped = TransformStamped(0, world, robot, Transform())
    assert (type(stamped.frame_id), stamped.child_frame_id) == (str, "robot")
    buffer.set_transform(stamped, authority=robot)
    batch = TransformBatch(
        (world, robot),
        np.array([(0, 1)], np.uint32),
        np.array([1]),
        np.array([(0, 0, 0, 0, 0, 0, 1)]),
    )
    assert buffer.set_transforms(batch, authority=robot) == 1
    assert buffer.lookup_transform(world, robot).child_frame_id == "robot"
    assert buffer.sent_by(robot) == {"robot": 2}
    assert buffer.frame(robot).samples == 2
    buffer.mark_gone([robot], True, robot)
    buffer.forget(robot, [robot])
    buffer.remove_sent([robot], robot)
    buffer.set_transform(stamped)
    buffer.remove(robot)


@pytest.mark.parametrize("wrong", [1, None, ["world"]])
def test_names_are_texts(wrong: Any):
    """Others are named by their type."""
    buffer = filled()
    for call in (
        lambda: buffer.lookup_transform(wrong, "robot"),
        lambda: buffer.lookup_transform("world", wrong),
        lambda: buffer.remove(wrong),
        lambda: buffer.sent_by(wrong),
        lambda: buffer.set_transform(moved(9 * S, "world", "robot"), authority=wrong),
        lambda: TransformBatch(
            ("world", wrong), np.zeros((0, 2), np.uint32), np.zeros(0), np.zeros((0, 7))
        ),
    ):
        with pytest.raises(InvalidArgumentException, match=type(wrong).__name__):
            call()


def test_points_come_first():
    """Frames before the points raise an error that names the order."""
    wrong: Any = "world"
    with pytest.raises(InvalidArgumentException, match="the points come first"):
        filled().transform_points(wrong, "robot", np.zeros((1, 3)))


def test_unknown_frames_stay_unknown():
    """A name of the right type that is not there is another error."""
    with pytest.raises(LookupException):
        filled().remove("nothing")
