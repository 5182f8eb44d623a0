"""Listeners while clocks are set, publishers begin anew, and frames are removed."""

import pytest

import tfbus
from tests.builders import x_of
from tfbus.base import scheduler
from tfbus.testing import Network


def _send(
    broadcaster: tfbus.TransformBroadcaster | tfbus.StaticTransformBroadcaster,
    node: tfbus.Node,
    *frames: str,
    x: float = 1.0,
) -> None:
    here = tfbus.Transform((x, 0.0, 0.0))
    broadcaster.send_transform(
        [tfbus.TransformStamped(node.now_ns(), "world", frame, here) for frame in frames]
    )


def _listening(network: Network, host: str) -> tfbus.Buffer:
    """The buffer of a listener on this host."""
    with network.process(network.host(host), "listener"):
        buffer = tfbus.Buffer()
        tfbus.TransformListener(buffer, tfbus.Node("listener"))
    return buffer


def test_a_frame_that_was_removed_before_the_first_list_goes(network: Network) -> None:
    """A message of it came, the first description is without it: it goes within a few seconds."""
    network.path(network.host("h1"), network.host("h2"), delay_s=0.5)
    with network.process("h1", "sim"):
        node = tfbus.Node("sim")
        broadcaster = tfbus.TransformBroadcaster(node)
        _send(broadcaster, node, "kept", "removed")
    network.run(5.0)
    with network.process("h2", "listener"):
        listener = tfbus.TransformListener(tfbus.Buffer(), tfbus.Node("listener"))
    network.run(until=lambda: not node.describe()["unread"])
    _send(broadcaster, node, "kept", "removed")
    broadcaster.remove("removed")
    buffer = listener.buffer
    network.run(until=lambda: "removed" in buffer.frames())
    network.run(5.0)
    assert buffer.frames() == ["kept", "world"]


def test_a_frame_stays_removed_though_what_was_kept_of_it_comes_late(network: Network) -> None:
    """The history of its stream waits for room on the link, and its publisher ends meanwhile."""
    robot, base = network.host("robot"), network.host("base")
    frames = ["kept", "removed"]
    with network.process(robot, "sim"):
        node = tfbus.Node("sim")
        broadcaster = tfbus.TransformBroadcaster(node, history_s=5.0)
    node.create_timer(0.25, lambda: _send(broadcaster, node, *frames))
    network.run(6.0)
    network.path(robot, base, delay_s=0.05, bytes_a_second=1500)
    with network.process(base, "listener"):
        buffer = tfbus.Buffer()
        listener = tfbus.TransformListener(buffer, tfbus.Node("listener"), history_s=5.0)
    network.run(until=lambda: "removed" in buffer.frames() and listener.streams()[0].frames)
    network.run(0.8)
    broadcaster.remove(frames.pop())
    network.run(until=lambda: buffer.frames() == ["kept", "world"])
    network.run(0.5)
    network.kill("robot/sim")
    network.run(15.0)
    assert buffer.frames() == ["kept", "world"]


def test_a_robot_that_is_looked_up_no_longer_leaves_nothing(network: Network) -> None:
    """A listener of a fleet that looks at one robot after the other keeps the frames, descriptions
    and counts of the last ones only, and answers for one of before as at first.
    """
    robots = 12
    for number in range(robots):
        with network.process(network.host(f"robot{number}"), "wheels"):
            node = tfbus.Node("wheels", namespace=f"robot{number}")
            broadcaster = tfbus.TransformBroadcaster(node)
            statics = tfbus.StaticTransformBroadcaster(node)
        here = tfbus.Transform((number, 0.0, 0.0))
        statics.send_transform(tfbus.TransformStamped(0, "base", "camera", here))

        def send(node=node, broadcaster=broadcaster) -> None:  # by their values
            _send(broadcaster, node, "base")

        node.create_timer(1.0, send)
    buffer = tfbus.Buffer()
    with network.process(network.host("base"), "listener"):
        listener = tfbus.TransformListener(
            buffer, tfbus.Node("listener"), fleet=tfbus.Fleet(("world",)), reads="needed"
        )

    def look(number: int) -> None:
        pair = ("world", f"robot{number}/camera")
        network.run(until=lambda: buffer.can_transform(*pair))
        assert buffer.lookup_transform(*pair).transform.x == 1.0 + number

    def known() -> list[str]:
        return [info.name for info in listener.streams() if info.frames or info.messages]

    for number in range(robots):
        look(number)
        network.run(20.0)
    assert len(known()) < robots
    network.run(200.0)
    assert known() == []
    assert not [frame for frame in buffer.frames() if frame.startswith("robot")]
    look(0)
    assert known() == ["robot0/wheels"]


def test_a_frame_whose_description_is_late_stays(network: Network) -> None:
    """One that was sent once, and is listed when the description comes, is not dropped."""
    network.path(network.host("h1"), network.host("h2"), delay_s=3.0)
    with network.process("h1", "sim"):
        node = tfbus.Node("sim")
        broadcaster = tfbus.TransformBroadcaster(node)
        _send(broadcaster, node, "first")
    with network.process("h2", "listener"):
        listener = tfbus.TransformListener(tfbus.Buffer(), tfbus.Node("listener"))
    network.run(30.0)
    _send(broadcaster, node, "second")
    network.run(30.0)
    assert listener.buffer.frames() == ["second", "world"]


def test_a_listener_whose_clock_is_set_back_brings_no_dead_publisher_back(
    network: Network,
) -> None:
    """The last message of a publisher that died lies in the future of the clock then."""
    network.host("h1"), network.host("h2")
    with network.process("h1", "sim"):
        node = tfbus.Node("sim")
        broadcaster = tfbus.TransformBroadcaster(node)

    def send() -> None:
        pose = tfbus.Transform((1.0, 0.0, 0.0))
        broadcaster.send_transform(tfbus.TransformStamped(node.now_ns(), "world", "robot", pose))

    node.create_timer(0.1, send)
    with network.process("h2", "listener"):
        listener = tfbus.TransformListener(tfbus.Buffer(), tfbus.Node("listener"))
    changes: list[str] = []
    network.run(until=lambda: "robot" in listener.buffer.frames())
    listener.buffer.on_change(lambda change: changes.append(change.kind))
    network.power_off("h1")
    network.host("h2").step_clock(-8.0)
    network.run(30.0)
    assert changes == ["publisher gone"]


def test_a_publisher_that_begins_anew_on_a_host_an_hour_ahead_is_taken(network: Network) -> None:
    """Its token comes before the end of the former one, whose process answers no more."""
    former, ahead = network.host("h1"), network.host("h2", offset_s=3600.0)
    network.path(former, network.host("h3"), delay_s=0.5)

    def publish(x: float) -> None:
        node = tfbus.Node("sim")
        _send(tfbus.StaticTransformBroadcaster(node), node, "mount", x=x)
        node.spin()

    buffer = _listening(network, "h3")
    network.start(former, "sim", publish, 1.0)
    network.run(until=lambda: x_of(buffer, "world", "mount") == 1.0)
    network.run(5.0)
    network.kill("h1/sim")
    network.start(ahead, "sim", publish, 2.0)
    network.run(until=lambda: x_of(buffer, "world", "mount") == 2.0)


def test_the_first_of_two_publishers_counts_again_after_a_clock_was_set_back(
    network: Network,
) -> None:
    """Its epoch, as that of the second, which has died, lies in the listener's future then."""

    def publish(x: float) -> None:
        node = tfbus.Node("sim")
        broadcaster = tfbus.TransformBroadcaster(node)
        _send(tfbus.StaticTransformBroadcaster(node), node, "mount", x=x)
        node.create_timer(0.5, lambda: _send(broadcaster, node, "robot"))
        node.spin()

    buffer = _listening(network, "h3")
    network.start(network.host("h1"), "sim", publish, 1.0)
    network.run(until=lambda: x_of(buffer, "world", "mount") == 1.0)
    network.start(network.host("h2"), "sim", publish, 2.0)
    network.run(until=lambda: x_of(buffer, "world", "mount") == 2.0)
    network.host("h3").step_clock(-3600.0)
    network.power_off("h2")
    died_ns = network.host("h1").time_ns()
    network.run(until=lambda: x_of(buffer, "world", "mount") == 1.0)
    network.run(until=lambda: (buffer.frame("robot").newest_ns or 0) > died_ns)


def test_static_transforms_of_the_survivor_of_two_do_not_hold_it_back(network: Network) -> None:
    """It sends them all the time: they count, and say nothing of the publisher that was later."""

    def publish(x: float) -> None:
        node = tfbus.Node("sim")
        dynamic = tfbus.TransformBroadcaster(node)
        static = tfbus.StaticTransformBroadcaster(node)

        def send() -> None:
            _send(dynamic, node, "robot", x=x)
            if x == 1.0:
                _send(static, node, "mount", x=x)

        node.create_timer(0.5, send)
        node.spin()

    buffer = _listening(network, "h3")
    network.start(network.host("h1"), "sim", publish, 1.0)
    network.run(until=lambda: x_of(buffer, "world", "robot") == 1.0)
    network.start(network.host("h2"), "sim", publish, 2.0)
    network.run(until=lambda: x_of(buffer, "world", "robot") == 2.0)
    network.run(5.0)
    network.power_off("h2")
    network.run(until=lambda: x_of(buffer, "world", "robot") == 1.0)


@pytest.mark.parametrize("dies", ["h1", "h2"])
def test_of_two_publishers_the_one_that_is_left_counts_though_it_is_silent(
    network: Network, dies: str
) -> None:
    """The end of the other is told by no token, and no message tells who is left."""

    def publish(x: float, messages: int) -> None:
        node = tfbus.Node("sim")
        dynamic = tfbus.TransformBroadcaster(node)
        _send(tfbus.StaticTransformBroadcaster(node), node, "mount", x=x)
        for _ in range(messages):
            _send(dynamic, node, "robot")
            scheduler.sleep(0.5)
        node.spin()

    buffer = _listening(network, "h3")
    # The first goes on to send after the second, and counts again.
    network.start(network.host("h1"), "sim", publish, 1.0, 40 if dies == "h1" else 4)
    network.run(until=lambda: x_of(buffer, "world", "mount") == 1.0)
    network.run(5.0)
    network.start(network.host("h2"), "sim", publish, 2.0, 4)
    network.run(until=lambda: x_of(buffer, "world", "mount") == 2.0)
    if dies == "h1":
        network.run(until=lambda: x_of(buffer, "world", "mount") == 1.0)
    counts = x_of(buffer, "world", "mount")
    for _ in range(30):
        network.run(1.0)
        assert x_of(buffer, "world", "mount") == counts
    network.power_off(dies)
    network.run(until=lambda: x_of(buffer, "world", "mount") == (2.0 if dies == "h1" else 1.0))
    network.run(5.0)
    assert not buffer.frame("mount").gone


def test_static_transforms_reach_a_listener_over_a_link_that_dynamic_ones_fill(
    network: Network,
) -> None:
    """On a bad network they are asked for before the others, and at once: nothing of them waits for
    transforms that the link has no room for.
    """
    robot, base = network.host("robot"), network.host("base")
    network.path(robot, base, delay_s=0.25, bytes_a_second=8_000.0)
    fixed, moving = [f"fixed{number}" for number in range(20)], range(50)

    def drive() -> None:
        with tfbus.Node(settings=tfbus.NodeSettings("driver", network="mobile")) as node:
            tfbus.StaticTransformBroadcaster(node).send_transform(
                [tfbus.TransformStamped(0, "base", name, tfbus.Transform()) for name in fixed]
            )
            broadcaster = tfbus.TransformBroadcaster(node)

            def tick() -> None:
                now_ns = node.now_ns()
                broadcaster.send_transform(
                    [
                        tfbus.TransformStamped(now_ns, "base", f"moving{each}", tfbus.Transform())
                        for each in moving
                    ]
                )

            node.create_timer(0.1, tick)
            node.spin()

    network.start(robot, "driver", drive)
    with network.process(base, "viewer"):
        node = tfbus.Node(settings=tfbus.NodeSettings("viewer", network="mobile"))
        network.run(5.0)
        buffer = tfbus.Buffer()
        tfbus.TransformListener(buffer, node)
        network.run(until=lambda: {*fixed} <= {*buffer.frames()})
        assert "moving49" not in buffer.frames()
