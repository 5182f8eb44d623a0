"""Subscriptions that pass a message on when its transform is known."""

import asyncio
import logging
from typing import Any

import numpy as np
import pytest

from tests.buses import eventually
from tests.fakes import Lines
from tests.simulated_bus import Bus
from tfbus import (
    Buffer,
    Transform,
    TransformArray,
    TransformBroadcaster,
    TransformListener,
    TransformStamped,
    messages,
)
from tfbus.base import scheduler
from tfbus.compat.sensor_msgs.msg import PointCloud2

S = 1_000_000_000


def pose_at(stamp_ns: int, frame: str = "base") -> messages.PoseStamped:
    """A message of this stamp and frame."""
    return messages.PoseStamped(stamp_ns, frame)


class Filtered:
    """A node that publishes, and one whose subscription waits for transforms into odom."""

    def __init__(self, bus: Bus, message_type: Any = messages.PoseStamped, **options: Any) -> None:
        self.buffer = Buffer()
        self.got: list[tuple[Any, Any]] = []
        self.node, self.other = bus.node("robot"), bus.node("sensor")
        self.subscription: Any = self.node.create_subscription(
            message_type,
            "poses",
            lambda message, transform: self.got.append((message, transform)),
            in_frame="odom",
            buffer=self.buffer,
            **options,
        )
        self.publisher = self.other.create_publisher(message_type, "poses")
        eventually(lambda: self.other.session.linked())
        probe = pose_at(0, "probe")
        if message_type is messages.PoseStamped:
            eventually(lambda: self.publisher.publish(probe) or self.subscription.received)
            scheduler.sleep(options.get("timeout_s", 5.0) + 1.0)
            self.subscription.drops.clear()
            self.subscription.received = 0

    def publish(self, *published: Any) -> None:
        """Publish, and let all arrive."""
        before = self.subscription.received
        for each in published:
            self.publisher.publish(each)
        eventually(lambda: self.subscription.received == before + len(published))

    def know(self, stamp_ns: int, frame: str = "base", x: float = 0.0) -> None:
        """Give the buffer the place of a frame."""
        self.buffer.set_transform(TransformStamped(stamp_ns, "odom", frame, Transform((x, 0, 0))))


def stamps(filtered: Filtered) -> list[int]:
    """The stamps of messages that came, in s."""
    return [message.stamp_ns // S for message, _ in filtered.got]


def test_a_message_comes_when_its_transform_is_known(bus: Bus) -> None:
    """With the transform at its stamp, and not before; one that is known comes at once."""
    it = Filtered(bus)
    it.know(1 * S, x=1.0)
    it.publish(pose_at(1 * S), pose_at(2 * S))
    eventually(lambda: it.got)
    assert stamps(it) == [1] and it.subscription.waiting == 1
    it.know(3 * S, x=3.0)
    eventually(lambda: len(it.got) == 2)
    assert it.got[1][1].transform.xyz.tolist() == [2.0, 0.0, 0.0]
    assert it.got[1][1].stamp_ns == 2 * S
    assert (it.subscription.waiting, it.subscription.passed, +it.subscription.drops) == (0, 2, {})


def test_messages_of_a_frame_come_in_order_and_others_do_not_wait_for_them(bus: Bus) -> None:
    """Also if the transform of a later one is known before; an unknown frame holds up no other."""
    it = Filtered(bus)
    it.know(1 * S)
    it.publish(pose_at(9 * S, "unknown"), pose_at(3 * S), pose_at(1 * S), pose_at(2 * S))
    assert it.got == []
    it.know(4 * S)
    eventually(lambda: len(it.got) == 3)
    assert stamps(it) == [3, 1, 2]
    it.know(9 * S, "unknown")
    eventually(lambda: len(it.got) == 4)


def test_each_message_that_is_dropped_has_a_reason(bus: Bus) -> None:
    """A full queue, an unknown frame, an old stamp, a timeout, and no frame."""
    it = Filtered(bus, queue=2, timeout_s=3.0)
    it.know(20 * S)
    it.know(21 * S)
    it.publish(pose_at(1 * S), pose_at(20 * S, ""), pose_at(22 * S, "nowhere"))
    it.publish(pose_at(23 * S), pose_at(24 * S))
    assert it.subscription.drops == {"too old": 1, "no frame": 1, "queue full": 1}
    it.publish(pose_at(25 * S, "nowhere"))
    assert it.subscription.drops["queue full"] == 2 and it.subscription.waiting == 2
    scheduler.sleep(3.5)
    assert it.subscription.drops == {
        "too old": 1,
        "no frame": 1,
        "queue full": 2,
        "frame unknown": 1,
        "timed out": 1,
    }
    assert it.got == [] and it.subscription.waiting == 0 and not it.buffer.waiting
    assert "nowhere" in it.subscription.last_drop


def test_a_message_of_before_the_subscription_is_no_warning(bus: Bus) -> None:
    """It is counted as too old; the first one since then is warned of."""
    node, other = bus.node("robot"), bus.node("sensor")
    buffer, warnings, all_lines = Buffer(), Lines(node.log, logging.WARNING), Lines(node.log)
    began_ns = node.now_ns()
    subscription = node.create_subscription(
        messages.PoseStamped, "poses", in_frame="odom", buffer=buffer
    )
    buffer.set_transform(TransformStamped(began_ns + 9 * S, "odom", "base", Transform()))
    publisher = other.create_publisher(messages.PoseStamped, "poses")
    early = pose_at(began_ns - S)
    eventually(lambda: publisher.publish(early) or subscription.drops["too old"])
    assert not warnings.lines and "from before this subscription" in all_lines.lines[-1]
    publisher.publish(pose_at(began_ns + S))
    eventually(lambda: warnings.lines)
    assert "(too old)" in warnings.lines[0] and "from before" not in warnings.lines[0]


def test_all_that_waited_for_one_transform_are_passed_on(bus: Bus) -> None:
    """In order, however many come at once; a callback that is slower still misses the oldest."""
    it = Filtered(bus, queue=50)
    it.know(1 * S)
    for second in (2, 3):
        it.publish(*[pose_at(second * S + each) for each in range(50)])
        it.know(second * S + 50)
        eventually(lambda: it.subscription.waiting == 0)
    eventually(lambda: len(it.got) == 100)
    sent = [second * S + each for second in (2, 3) for each in range(50)]
    assert [message.stamp_ns for message, _ in it.got] == sent
    assert (it.subscription.dropped, +it.subscription.drops) == (0, {})


def test_a_slow_callback_misses_the_oldest_of_what_it_has_not_taken(bus: Bus) -> None:
    """Of messages that come one by one at most ten wait, and of a burst no more than the queue."""
    it = Filtered(bus, queue=20)
    begun = scheduler.Event()
    ends = scheduler.Event()
    it.node.create_timer(0.01, lambda: begun.set() or ends.wait())
    eventually(begun.is_set)
    it.know(1 * S)
    it.publish(*[pose_at(1 * S) for _ in range(15)])
    assert it.subscription.dropped == 5
    ends.set()
    eventually(lambda: len(it.got) == 10)


@pytest.mark.parametrize("frame", ["/base", "b\nase", "b" * 300])
def test_a_frame_that_cannot_be_is_no_frame(bus: Bus, frame: str) -> None:
    """Its message is not said to be too old."""
    it = Filtered(bus)
    it.know(1 * S)
    it.publish(pose_at(1 * S, frame))
    assert it.subscription.drops == {"no frame": 1} and "frame_id" in it.subscription.last_drop


def test_a_tolerance_waits_for_later_transforms_too(bus: Bus) -> None:
    """The message comes with that at its stamp once that of the tolerance later is known."""
    it = Filtered(bus, tolerance_s=0.5)
    it.know(1 * S)
    it.know(2 * S)
    it.publish(pose_at(2 * S))
    assert it.got == []
    it.know(2 * S + S // 2)
    eventually(lambda: it.got)
    assert it.got[0][1].stamp_ns == 2 * S


def test_a_scan_has_a_transform_for_each_range(bus: Bus) -> None:
    """It waits for the last one."""
    it = Filtered(bus, messages.LaserScan)
    scan = messages.LaserScan(1 * S, "base", time_increment=0.25, ranges=np.ones(5, np.float32))
    it.know(1 * S)
    eventually(lambda: it.publisher.publish(scan) or it.subscription.received)
    assert it.got == []
    it.know(2 * S, x=4.0)
    eventually(lambda: it.got)
    moved = it.got[0][1]
    assert isinstance(moved, TransformArray)
    assert moved.xyz[:, 0].tolist() == [0.0, 1.0, 2.0, 3.0, 4.0]


def test_the_buffer_is_that_of_the_nodes_listener(bus: Bus) -> None:
    """Transforms from the bus let a message through; without a listener it says what is missing."""
    node, other = bus.node("robot"), bus.node("sensor")
    with pytest.raises(ValueError, match="TransformListener"):
        node.create_subscription(messages.PoseStamped, "poses", print, in_frame="odom")
    got: list[Any] = []
    TransformListener(Buffer(), node)
    node.create_subscription(
        messages.PoseStamped, "poses", lambda *pair: got.append(pair), in_frame="odom"
    )
    publisher = other.create_publisher(messages.PoseStamped, "poses")
    broadcaster = TransformBroadcaster(other)

    def sent() -> bool:
        stamp_ns = other.now_ns()
        publisher.publish(pose_at(stamp_ns))
        broadcaster.send_transform(TransformStamped(stamp_ns, "odom", "base", Transform()))
        return bool(got)

    eventually(sent)
    assert got[0][0].stamp_ns == got[0][1].stamp_ns


def test_a_subscription_without_a_callback_is_iterated_over(bus: Bus) -> None:
    """By `for` in any thread and by `async for`, with transforms or without, until it is closed."""
    node, other = bus.node("robot"), bus.node("sensor")
    buffer = Buffer()
    buffer.set_transform(TransformStamped(1 * S, "odom", "base", Transform((1, 2, 3))))
    plain = node.create_subscription(messages.PoseStamped, "poses")
    framed = node.create_subscription(messages.PoseStamped, "poses", in_frame="odom", buffer=buffer)
    found: list[Any] = []

    def read() -> None:
        found.extend(each for _, each in zip(range(2), plain, strict=False))

    thread = scheduler.Thread(target=read)
    thread.start()
    publisher = other.create_publisher(messages.PoseStamped, "poses")
    eventually(lambda: publisher.publish(pose_at(1 * S)) or len(found) == 2)
    thread.join()

    async def first() -> Any:
        async for pair in framed:
            return pair

    message, transform = asyncio.run(first())
    assert (message.stamp_ns, transform.transform.xyz.tolist()) == (1 * S, [1.0, 2.0, 3.0])
    plain.close()
    assert [*plain] == []
    with pytest.raises(TypeError, match="has a callback"):
        iter(node.create_subscription(messages.PoseStamped, "poses", print)).__next__()


def test_bounds_and_types_are_checked(bus: Bus) -> None:
    """A message without a frame, a queue of no length, a time that is none."""
    node, buffer = bus.node("robot"), Buffer()

    def create(kind: Any = messages.PoseStamped, **options: Any) -> Any:
        return node.create_subscription(
            kind, "poses", print, in_frame="odom", buffer=buffer, **options
        )

    with pytest.raises(TypeError, match=r"those of MarkerArray have markers$"):
        create(messages.MarkerArray)
    with pytest.raises(TypeError, match=r"must have stamp_ns and frame_id, .* PointCloud2 have"):
        create(PointCloud2)
    with pytest.raises(ValueError, match="queue"):
        create(queue=0)
    with pytest.raises(ValueError, match="tolerance_s"):
        create(tolerance_s=-1.0)
    with pytest.raises(TypeError, match="transform"):
        node.create_subscription(
            messages.PoseStamped,
            "poses",
            lambda message: None,  # type: ignore[arg-type, misc]
            in_frame="odom",
            buffer=buffer,
        )


def test_tools_say_what_waits_and_what_was_dropped(bus: Bus) -> None:
    """`topic info`, `why` and the doctor, by the node, the topic and the reasons, and when."""
    it = Filtered(bus, queue=1)
    it.publish(pose_at(1 * S, "lidar"), pose_at(2 * S, "lidar"))
    counts = "topic poses into 'odom': 0 passed, 1 waiting, 1 dropped (1 queue full)"
    info = bus.run("topic", "info", "poses")
    assert f"/robot: {counts}; the last at " in info.stdout
    assert f"    Filter: {counts}" in bus.run("topic", "info", "poses", "-v").stdout
    why = bus.run("why", "odom", "lidar")
    assert "Messages that wait" in why.stdout and "poses" in why.stdout
    doctor = " ".join(bus.run("doctor").stdout.split())
    assert counts in doctor and "tfbus why odom lidar" in doctor


def test_all_that_wait_have_one_timer(bus: Bus) -> None:
    """It ends with the subscription."""
    filtered = Filtered(bus, queue=10, timeout_s=60.0)
    executor = filtered.node.executor
    before = executor.waiting()[1]
    filtered.publish(*(pose_at(stamp * S, "nowhere") for stamp in range(1, 31)))
    assert executor.waiting()[1] == before + 1
    filtered.subscription.close()
    eventually(lambda: executor.waiting()[1] <= before)


def test_a_node_keeps_nothing_of_a_closed_one(bus: Bus) -> None:
    """However many a program makes and closes."""
    node = bus.node("robot")
    before = list(node.describers)
    made = node.create_subscription(messages.PoseStamped, "poses", in_frame="odom", buffer=Buffer())
    assert [each["topic"] for each in node.describe()["filters"]] == ["poses"]
    made.close()
    made.close()
    assert node.describers == before and "filters" not in node.describe()
