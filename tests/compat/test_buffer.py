"""The laws that geometry2's own Python tests check of its buffer, and the differences."""

import asyncio
import threading
from typing import Any

import pytest

import tfbus
from tests.buses import eventually
from tests.fakes import InAThread
from tfbus.compat import tf2_py, tf2_ros
from tfbus.compat.builtin_interfaces.msg import Time as Stamp
from tfbus.compat.geometry_msgs.msg import TransformStamped
from tfbus.compat.rclpy.duration import Duration
from tfbus.compat.rclpy.time import Time
from tfbus.compat.tf2_ros import Buffer


def edge(parent: str, child: str, seconds: float, x: float = 1.0) -> TransformStamped:
    """A child at x in its parent."""
    message = TransformStamped(child_frame_id=child)
    message.header.frame_id = parent
    message.header.stamp = Time(seconds=seconds).to_msg()
    message.transform.translation.x = x
    return message


def filled(*edges: TransformStamped) -> Buffer:
    """A buffer with these dynamic transforms."""
    buffer = Buffer()
    for each in edges:
        buffer.set_transform(each, "test")
    return buffer


@pytest.mark.parametrize("cache_time", [None, Duration(seconds=60)])
def test_what_was_set_is_found(cache_time: Duration | None) -> None:
    """The same message comes back, whatever the length of the cache."""
    buffer = Buffer(cache_time=cache_time)
    sent = edge("foo", "bar", 100.0)
    assert buffer.set_transform(sent, "test") is None
    assert buffer.can_transform("foo", "bar", Time(seconds=100))
    assert buffer.lookup_transform("foo", "bar", sent.header.stamp) == sent


def test_zero_is_the_latest_time() -> None:
    """`Time()` and an empty stamp ask for the latest common time."""
    buffer = filled(edge("a", "b", 1.0), edge("a", "b", 3.0, x=5.0))
    for latest in (Time(), Stamp()):
        found = buffer.lookup_transform("a", "b", latest)
        assert (found.header.stamp, found.transform.translation.x) == (Stamp(sec=3), 5.0)
    assert buffer.get_latest_common_time("a", "b") == Time(seconds=3)


def test_two_times_and_a_fixed_frame() -> None:
    """The answer has the time of the target."""
    buffer = filled(*(edge("map", "base", s, x=s) for s in (1.0, 2.0)))
    found = buffer.lookup_transform_full("base", Time(seconds=2), "base", Time(seconds=1), "map")
    assert found.transform.translation.x == -1.0
    assert found.header.stamp == Stamp(sec=2)
    assert buffer.can_transform_full("base", Time(seconds=2), "base", Time(seconds=1), "map")
    assert not buffer.can_transform_full("base", Time(seconds=3), "base", Time(seconds=1), "map")


def test_a_static_transform_holds_at_all_times() -> None:
    """And has the stamp that was asked for."""
    buffer = Buffer()
    buffer.set_transform_static(edge("a", "b", 1.0), "test")
    assert buffer.lookup_transform("a", "b", Time(seconds=9)).header.stamp == Stamp(sec=9)


@pytest.mark.parametrize(
    ("seconds", "words"),
    [(0.5, "extrapolation into the past"), (9, "extrapolation into the future")],
)
def test_times_outside_of_the_samples_are_named_as_by_tf2(seconds: float, words: str) -> None:
    """In the exception, and in what can_transform says."""
    buffer = filled(edge("a", "b", 1.0), edge("a", "b", 2.0))
    with pytest.raises(tf2_ros.ExtrapolationException, match=f"Lookup would require {words}"):
        buffer.lookup_transform("a", "b", Time(seconds=seconds))
    can, why = buffer.can_transform("a", "b", Time(seconds=seconds), return_debug_tuple=True)
    assert not can and words in why
    assert buffer.can_transform_core("a", "b", Time(seconds=1.5)) == (True, "")


@pytest.mark.parametrize(
    "name",
    [
        "TransformException",
        "LookupException",
        "ConnectivityException",
        "ExtrapolationException",
        "InvalidArgumentException",
        "TimeoutException",
    ],
)
def test_the_exceptions_are_those_of_tfbus(name: str) -> None:
    """A program may catch either."""
    assert getattr(tf2_ros, name) is getattr(tf2_py, name) is getattr(tfbus, name)


@pytest.mark.parametrize(
    ("target", "source", "kind"),
    [
        ("a", "nowhere", tf2_ros.LookupException),
        ("a", "c", tf2_ros.ConnectivityException),
        ("/a", "b", tf2_ros.InvalidArgumentException),
        ("", "b", tf2_ros.InvalidArgumentException),
    ],
)
def test_each_reason_has_its_exception(target: str, source: str, kind: type[Exception]) -> None:
    """The same after a wait: tf2 raises what was missing, not that time is up."""
    buffer = filled(edge("a", "b", 1.0), edge("other", "c", 1.0))
    for timeout in (Duration(), Duration(nanoseconds=1_000_000)):
        with pytest.raises(kind) as caught:
            buffer.lookup_transform(target, source, Time(), timeout)
        assert type(caught.value) is kind


def test_what_a_wait_missed_is_said_with_its_length() -> None:
    """And the advice names the arguments as ROS has them."""
    buffer = filled(edge("a", "b", 1.0), edge("a", "b", 2.0))
    with pytest.raises(tf2_ros.ExtrapolationException, match=r"\(timed out after 0.001 s\)"):
        buffer.lookup_transform("a", "b", Time(seconds=3), Duration(nanoseconds=1_000_000))
    with pytest.raises(tf2_ros.ExtrapolationException) as caught:
        buffer.lookup_transform("a", "b", Time(seconds=3))
    assert "timeout=Duration(seconds=...)" in str(caught.value)
    assert "Time()" in str(caught.value) and "_ns" not in str(caught.value)


def test_a_lookup_waits_in_any_thread() -> None:
    """It returns as soon as the transform is set."""
    buffer = Buffer()
    waiting = InAThread(lambda: buffer.lookup_transform("a", "b", Time(), Duration(seconds=60)))
    eventually(lambda: buffer.tfbus_buffer.waiting)
    buffer.set_transform(edge("a", "b", 1.0), "test")
    assert waiting.result() == edge("a", "b", 1.0)


def test_a_future_of_what_is_there_is_done() -> None:
    """Without a step of anything."""
    sent = edge("a", "b", 1.0)
    buffer = filled(sent)
    time = sent.header.stamp
    assert buffer.wait_for_transform_async("a", "b", time).result() == sent
    full = buffer.wait_for_transform_full_async("a", time, "b", time, "a")
    assert full.done() and full.result() == sent


@pytest.mark.parametrize("full", [False, True])
def test_a_coroutine_goes_on_once_the_transform_is_there(full: bool) -> None:
    """Stepped by hand, as an executor does: not before, and then at once."""
    buffer, sent = Buffer(), edge("a", "b", 1.0)
    time = sent.header.stamp
    coroutine = (
        buffer.lookup_transform_full_async("a", time, "b", time, "a")
        if full
        else buffer.lookup_transform_async("a", "b", time)
    )
    coroutine.send(None)
    coroutine.send(None)
    buffer.set_transform(sent, "test")
    with pytest.raises(StopIteration) as ended:
        coroutine.send(None)
    assert ended.value.value == sent


def test_asyncio_waits_for_a_transform() -> None:
    """The coroutine and the future are awaited in a running loop."""
    buffer, sent = Buffer(), edge("a", "b", 1.0)

    async def both() -> list[Any]:
        timer = threading.Timer(0.01, buffer.set_transform, (sent, "test"))
        timer.start()
        future = buffer.wait_for_transform_async("a", "b", Time())
        return [await buffer.lookup_transform_async("a", "b", Time()), await future]

    assert asyncio.run(both()) == [sent, sent]


def test_callbacks_of_a_future_are_called_once() -> None:
    """Callbacks that were added before are, and callbacks that come too late."""
    buffer, called = Buffer(), []
    future = buffer.wait_for_transform_async("a", "b", Time())
    future.add_done_callback(lambda done: called.append(done.result()))
    assert not future.done() and future.result() is None
    buffer.set_transform(edge("a", "b", 1.0), "test")
    eventually(lambda: called)
    future.add_done_callback(called.append)
    assert called == [edge("a", "b", 1.0), future]


def test_a_future_says_at_once_what_waiting_does_not_help() -> None:
    """tf2 waits for ever for a time before the samples."""
    future = filled(edge("a", "b", 1.0), edge("a", "b", 2.0)).wait_for_transform_async(
        "a", "b", Time(seconds=0.5)
    )
    assert isinstance(eventually(future.exception), tf2_ros.ExtrapolationException)
    with pytest.raises(tf2_ros.ExtrapolationException, match="into the past"):
        future.result()


def test_a_cancelled_future_waits_no_longer() -> None:
    """Nothing of it stays in the buffer."""
    buffer = Buffer()
    future = buffer.wait_for_transform_async("a", "b", Time())
    eventually(lambda: buffer.tfbus_buffer.waiting)
    future.cancel()
    eventually(lambda: not buffer.tfbus_buffer.waiting)
    assert future.cancelled() and future.done() and future.result() is None


def test_frames_are_told_as_text() -> None:
    """As YAML, and as tf2's lines."""
    buffer = filled(edge("bar", "foo", 1.0))
    assert "parent: 'bar'" in buffer.all_frames_as_yaml()
    assert buffer.all_frames_as_string() == "Frame foo exists with parent bar.\n"
    assert buffer._frameExists("foo") and buffer._getFrameStrings() == ["bar", "foo"]


def test_clear_forgets_what_is_dynamic() -> None:
    """As tf2 did up to Kilted; a static transform stays."""
    buffer = filled(edge("a", "b", 1.0))
    buffer.set_transform_static(edge("b", "c", 1.0), "test")
    buffer.clear()
    assert not buffer.can_transform("a", "b", Time())
    assert buffer.can_transform("b", "c", Time())


def test_a_velocity_is_that_of_the_motion() -> None:
    """Three metres a second, from five samples a second apart."""
    buffer = filled(*(edge("parent", "body", s, x=3.0 * s) for s in range(5)))
    interval = Duration(seconds=4, nanoseconds=1_000_000)
    short = buffer.lookupVelocityCore("body", "parent", Time(), interval)
    assert short[0] == pytest.approx((3, 0, 0)) and short[1] == pytest.approx((0, 0, 0))
    assert short == buffer.lookupVelocityFullCore(
        "body", "parent", "parent", (0, 0, 0), "body", Time(), interval
    )


def test_a_point_off_the_axis_of_a_turn_moves_sideways() -> None:
    """A metre from the axis, at a radian a second."""
    from math import cos, sin

    buffer = Buffer()
    for step in range(11):
        message = edge("parent", "body", 100 + step / 10, x=0.0)
        message.transform.rotation.z = sin((step - 5) / 20)
        message.transform.rotation.w = cos((step - 5) / 20)
        buffer.set_transform(message, "test")
    linear, angular = buffer.lookupVelocityFullCore(
        "body", "parent", "parent", (1, 0, 0), "body", Time(seconds=100.5), Duration(seconds=0.4)
    )
    assert linear == pytest.approx((0, 1, 0), abs=1e-6)
    assert angular == pytest.approx((0, 0, 1), abs=1e-6)


@pytest.mark.parametrize(
    "call",
    [
        lambda buffer: buffer.lookup_transform("a", "b", 0.0),
        lambda buffer: buffer.lookup_transform("a", "b", Time(), 1.0),
        lambda buffer: buffer.wait_for_transform_async("a", "b", 1),
        lambda buffer: buffer.set_transform(object(), "test"),
        lambda buffer: Buffer(cache_time=10.0),
        lambda buffer: Buffer(qos=5),
    ],
)
def test_a_mistake_in_a_call_is_no_failed_lookup(call: Any) -> None:
    """It is a TypeError, which `except TransformException` lets through."""
    with pytest.raises(TypeError):
        call(filled(edge("a", "b", 1.0)))


@pytest.mark.parametrize("name", ["BufferClient", "BufferServer", "StaticTransformListener"])
def test_what_is_missing_says_what_to_do(name: str) -> None:
    """When it is imported."""
    with pytest.raises(ImportError, match=f"no {name}: "):
        getattr(tf2_ros, name)


@pytest.mark.parametrize(
    ("module", "name", "says"),
    [
        ("rclpy", "get_global_executor", "SingleThreadedExecutor"),
        ("rclpy", "nonsense", "tfbus.Node"),
        ("geometry_msgs.msg", "Wrenches", "did you mean Wrench. it has Accel, .*dataclass"),
        ("turtlesim.srv", "Nonsense", "dataclass"),
    ],
)
def test_every_module_says_what_to_do_without_a_name(module: str, name: str, says: str) -> None:
    """In the sentence that `from ... import` shows; Python's own questions are answered as ever."""
    with pytest.raises(ImportError, match=f"has no {name}: .*{says}"):
        exec(f"from tfbus.compat.{module} import {name}")
    assert not hasattr(tf2_ros, "__wrapped__")


def test_an_old_transform_is_left_out_and_logged(caplog: pytest.LogCaptureFixture) -> None:
    """As tf2 does, without an exception."""
    buffer = filled(edge("a", "b", 100.0), edge("a", "b", 50.0, x=9.0))
    assert "Left out a transform" in caplog.text and "'b', sent by 'test'" in caplog.text
    assert buffer.lookup_transform("a", "b", Time()).transform.translation.x == 1.0


def test_objects_with_the_fields_of_ros_are_transforms() -> None:
    """Of whatever class, as the messages of ROS itself are."""

    class Namespace:
        def __init__(self, **fields: Any) -> None:
            self.__dict__ |= fields

    numbers = {"x": 1.0, "y": 0.0, "z": 0.0}
    message = Namespace(
        header=Namespace(stamp=Namespace(secs=1, nsecs=0), frame_id="a"),
        child_frame_id="b",
        transform=Namespace(translation=Namespace(**numbers), rotation=Namespace(**numbers, w=0.0)),
    )
    buffer = Buffer()
    buffer.set_transform(message, "ros")
    assert buffer.lookup_transform("a", "b", Time()).transform.rotation.x == 1.0
