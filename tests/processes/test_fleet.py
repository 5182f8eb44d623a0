"""Robots with equal frame names: apart by their namespaces, and together as a fleet."""

import time
from signal import SIGKILL

import pytest

from tests.builders import S, moved, x_of
from tests.buses import eventually
from tests.processes.publishers import launch
from tests.simulated_bus import Bus
from tfbus import (
    Buffer,
    Change,
    Fleet,
    Node,
    StaticTransformBroadcaster,
    TransformBroadcaster,
    TransformListener,
)
from tfbus.inspect import StreamInfo
from tfbus.testing.programs import Program

PATIENCE_S = 20.0
FLEET = Fleet(shared_frames=("world", "map"))


def robot(bus: Bus, number: int, *arguments: str) -> Program:
    """A robot whose wheels move in the map, as many metres ahead as its number says."""
    moving = ("--moving", "map:base_link", "--x", str(number))
    return launch(bus, "wheels", "--namespace", f"robot{number}", *moving, *arguments)


@pytest.fixture
def receiver(bus: Bus) -> Node:
    return bus.node("tower")


def test_ten_robots_with_equal_frames_are_apart_by_their_namespaces_alone(bus: Bus) -> None:
    """`--namespace robot7` and nothing else keeps a robot's frames and its lookups its own."""
    for number in range(10):
        namespace = f"robot{number}"
        bus.start("static", "map", "base_link", "--x", str(number), "--namespace", namespace)
    for number in range(10):
        buffer = Buffer()
        with TransformListener(buffer, bus.node("listener", namespace=f"robot{number}")) as own:
            found = buffer.lookup_transform("map", "base_link", timeout_s=3 * PATIENCE_S)
            assert found.transform.x == pytest.approx(number)
            assert buffer.frames() == ["base_link", "map"]
            assert len(own.streams()) == 1


def test_who_sees_the_fleet_sees_each_robot_by_its_name(bus: Bus, receiver: Node) -> None:
    """One listener sees all robots, their frames with the robot's name in front, in the map that
    they share; statics come to who starts last, too.
    """
    robot(bus, 3, "--static", "base_link:camera")
    robot(bus, 7).wait_for_line("ready")
    buffer = Buffer()
    with TransformListener(buffer, receiver, fleet=FLEET):
        found = buffer.lookup_transform("robot3/camera", "robot7/base_link", timeout_s=PATIENCE_S)
        assert found.transform.x == pytest.approx(7 - 3 - 3)
    assert buffer.frames() == ["map", "robot3/base_link", "robot3/camera", "robot7/base_link"]
    assert buffer.frame("robot3/camera").static
    assert buffer.frame("robot7/base_link").authority == "robot7/wheels"


def test_frames_that_are_not_shared_stay_apart(bus: Bus, receiver: Node) -> None:
    """Without shared frames each robot has a map of its own."""
    robot(bus, 3)
    robot(bus, 7)
    buffer = Buffer()
    with TransformListener(buffer, receiver, fleet=Fleet()):
        eventually(lambda: x_of(buffer, "robot3/map", "robot3/base_link") == 3)
        eventually(lambda: x_of(buffer, "robot7/map", "robot7/base_link") == 7)
        assert not buffer.can_transform("robot3/map", "robot7/map")


def test_what_is_outside_of_all_namespaces_keeps_its_names(bus: Bus, receiver: Node) -> None:
    """The tower's own frames, and those of nodes beside it, are seen as they are called."""
    robot(bus, 7)
    StaticTransformBroadcaster(bus.node("surveyor")).send_transform(moved(S, "world", "map", 100))
    buffer = Buffer()
    with TransformListener(buffer, receiver, fleet=FLEET):
        found = buffer.lookup_transform("world", "robot7/base_link", timeout_s=PATIENCE_S)
        assert found.transform.x == pytest.approx(107)


def test_only_the_robots_of_a_lookup_are_read(bus: Bus, receiver: Node) -> None:
    """A fleet can be read by need: of robots that no lookup needs neither transforms come nor the
    names of their frames; only that they are there.
    """
    for number in (3, 5, 7):
        robot(bus, number)
    buffer = Buffer()
    with TransformListener(buffer, receiver, fleet=FLEET, reads="needed") as listener:
        found = buffer.lookup_transform(
            "robot3/base_link", "robot7/base_link", timeout_s=PATIENCE_S
        )
        assert found.transform.x == pytest.approx(4)

        def streams() -> dict[str, StreamInfo]:
            return {info.namespace: info for info in listener.streams() if info.alive}

        eventually(lambda: len(streams()) == 3 and streams()["robot7"].messages > 20)
        assert streams()["robot7"].frames == (("map", "robot7/base_link", False),)
        assert (streams()["robot5"].messages, streams()["robot5"].frames) == (0, ())


def test_a_robot_that_says_where_a_shared_frame_is_is_found(bus: Bus, receiver: Node) -> None:
    """A shared frame may come from any robot, also from one that says so later, or comes later."""
    shared = Fleet(shared_frames=("map", "hall", "site"))
    robot(bus, 3)
    robot(bus, 5)
    buffer = Buffer()
    with TransformListener(buffer, receiver, fleet=shared, reads="needed") as listener:
        buffer.lookup_transform("map", "robot3/base_link", timeout_s=PATIENCE_S)
        slam = StaticTransformBroadcaster(bus.node("slam", namespace="robot5"))
        slam.send_transform(moved(S, "hall", "map", 10))
        found = buffer.lookup_transform("hall", "robot3/base_link", timeout_s=PATIENCE_S)
        assert found.transform.x == pytest.approx(13)
        StaticTransformBroadcaster(bus.node("survey", namespace="robot7")).send_transform(
            moved(S, "site", "hall", 100)
        )
        found = buffer.lookup_transform("site", "robot3/base_link", timeout_s=PATIENCE_S)
        assert found.transform.x == pytest.approx(113)
        described = {info.name for info in listener.streams() if info.frames}
        assert described == {"robot3/wheels", "robot5/slam", "robot7/survey"}


def test_of_a_split_stream_of_a_robot_single_frames_are_read(bus: Bus, receiver: Node) -> None:
    """Frames on keys of their own are found by their names inside of the robot."""
    robot(bus, 7, "--moving", "map:other", "--split")
    buffer = Buffer()
    with TransformListener(buffer, receiver, fleet=FLEET, reads="needed"):
        found = buffer.lookup_transform("map", "robot7/base_link", timeout_s=PATIENCE_S)
        assert found.transform.x == pytest.approx(7)
        assert buffer.frames() == ["map", "robot7/base_link"]


def test_a_robot_that_is_gone_says_so_and_comes_back(bus: Bus, receiver: Node) -> None:
    """The frames of a robot that is killed are marked, the other robots' are not; started again,
    its new epoch counts.
    """
    first = robot(bus, 3, "--static", "base_link:camera")
    robot(bus, 7)
    buffer = Buffer()
    with TransformListener(buffer, receiver, fleet=FLEET):
        buffer.lookup_transform("robot7/base_link", "robot3/camera", timeout_s=PATIENCE_S)
        first.signal(SIGKILL)
        eventually(lambda: buffer.frame("robot3/base_link").gone)
        assert buffer.frame("robot3/camera").gone
        assert not buffer.frame("robot7/base_link").gone
        robot(bus, 3)
        eventually(lambda: not buffer.frame("robot3/base_link").gone)
        eventually(lambda: buffer.frame("robot3/camera").gone)


def test_a_frame_that_a_robot_removes_is_removed(bus: Bus, receiver: Node) -> None:
    """What a robot takes out of its stream leaves the buffer of who sees the fleet."""
    sender = TransformBroadcaster(bus.node("wheels", namespace="robot7"))
    buffer = Buffer()
    with TransformListener(buffer, receiver, fleet=FLEET):
        stamps = iter(range(10**9, 10**12))

        def is_there() -> bool:
            sender.send_transform(moved(next(stamps), "map", "base_link", 7))
            sender.send_transform(moved(next(stamps), "base_link", "cup", 1))
            return buffer.can_transform("map", "robot7/cup")

        eventually(is_there)
        sender.remove("cup")
        eventually(lambda: "robot7/cup" not in buffer.frames())
        assert "robot7/base_link" in buffer.frames()


def test_history_comes_from_all_robots(bus: Bus, receiver: Node) -> None:
    """Who sees the fleet may ask for the last seconds of all robots."""
    first_ns = time.time_ns() - 2 * 10**9
    for number in (3, 7):
        sender = TransformBroadcaster(bus.node("wheels", namespace=f"robot{number}"))
        for i in range(2):
            sender.send_transform(moved(first_ns + i * S, "map", "base_link", number))
    buffer = Buffer()
    with TransformListener(buffer, receiver, fleet=FLEET, history_s=10):
        found = buffer.lookup_transform(
            "robot3/base_link", "robot7/base_link", first_ns + 5 * 10**8, timeout_s=PATIENCE_S
        )
        assert found.transform.x == pytest.approx(4)


def test_only_frames_of_one_name_outside_are_in_conflict(bus: Bus, receiver: Node) -> None:
    """Equal names of two robots are no conflict; two publishers within a robot are, and so are
    two robots that say where a shared frame is.
    """
    report: list[Change] = []
    buffer = Buffer()
    buffer.on_change(lambda change: report.append(change) if change.kind == "conflict" else None)
    with TransformListener(buffer, receiver, fleet=FLEET) as listener:
        for number in (3, 7):
            node = bus.node("model", namespace=f"robot{number}")
            StaticTransformBroadcaster(node).send_transform(moved(S, "base_link", "camera", 1))
        eventually(lambda: sum(bool(info.frames) for info in listener.streams()) == 2)
        assert report == []
        other = bus.node("other", namespace="robot7")
        StaticTransformBroadcaster(other).send_transform(moved(S, "base_link", "camera", 2))
        eventually(lambda: {change.frame for change in report} == {"robot7/camera"})
        for number in (3, 7):
            node = bus.node("slam", namespace=f"robot{number}")
            StaticTransformBroadcaster(node).send_transform(moved(S, "world", "map", number))
        eventually(lambda: {change.frame for change in report} == {"robot7/camera", "map"})


def test_a_fleet_may_be_in_a_namespace_itself(bus: Bus) -> None:
    """Who sees a fleet from within a namespace sees the robots below it, and no others."""
    launch(bus, "wheels", "--namespace", "lab/robot7", "--moving", "map:base_link", "--x", "7")
    launch(bus, "wheels", "--namespace", "hall/robot3", "--moving", "map:base_link", "--x", "3")
    lab, everywhere = Buffer(), Buffer()
    with (
        TransformListener(lab, bus.node("tower", namespace="lab"), fleet=FLEET),
        TransformListener(everywhere, bus.node("tower"), fleet=FLEET),
    ):
        eventually(lambda: x_of(lab, "map", "robot7/base_link") == 7)
        eventually(lambda: x_of(everywhere, "map", "hall/robot3/base_link") == 3)
        eventually(lambda: x_of(everywhere, "map", "lab/robot7/base_link") == 7)
        assert lab.frames() == ["map", "robot7/base_link"]
