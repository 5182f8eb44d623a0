"""The simulated time reaches the namespaces that have nodes, of which there may be many."""

import pytest

from tests.buses import eventually
from tests.simulated_bus import Bus
from tfbus import Node
from tfbus.messages import Clock
from tfbus.node import clock_topic

S = 1_000_000_000


@pytest.fixture(autouse=True)
def room_for_two(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(clock_topic, "_MOST_NAMESPACES", 2)


def follower(bus: Bus, namespace: str) -> Node:
    """A node there that has the time."""
    node = bus.node("follower", namespace=namespace, sim_time=True)
    assert node.wait_for_clock(20.0)
    return node


def test_namespaces_without_nodes_make_room_for_new_ones(
    bus: Bus, capsys: pytest.CaptureFixture[str]
) -> None:
    """Robots come and go without end, and each gets the time while it is there."""
    clock = bus.node("clock").create_clock_publisher()
    clock.publish(Clock(5 * S, 1.0, False))
    stays = follower(bus, "stays")
    for number in range(4):
        follower(bus, f"robot{number}").close()
    clock.publish(Clock(6 * S, 1.0, False))
    eventually(lambda: stays.now_ns() == 6 * S)
    assert "stands still" not in capsys.readouterr().err


def test_of_too_many_namespaces_the_first_gives_way_and_the_log_says_so(
    bus: Bus, capsys: pytest.CaptureFixture[str]
) -> None:
    """A robot that has just started is looked at; the log names one that has the time no more."""
    clock = bus.node("clock").create_clock_publisher()
    clock.publish(Clock(5 * S, 1.0, False))
    nodes = [follower(bus, name) for name in ("one", "two", "three")]
    clock.publish(Clock(6 * S, 1.0, False))
    eventually(lambda: nodes[1].now_ns() == nodes[2].now_ns() == 6 * S)
    assert nodes[0].now_ns() == 5 * S
    log = capsys.readouterr().err
    assert log.count("stands still") == 1
    assert "'one' stands still, and 'three'" in log
