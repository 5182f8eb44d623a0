"""Many frames, bursts, and subscribers that do not keep up, between processes."""

import signal
import sys
from pathlib import Path
from typing import Any

import pytest

from tests import simulated_bus
from tests.buses import DEADLINE_S, eventually, send_until
from tests.live_bus import Bus, Process, free_port
from tests.processes.load_roles import Load, Report, batch, heard, memory, x_of
from tfbus import Buffer, Node, ServiceError, TransformBroadcaster, TransformListener
from tfbus.node.service import Client

ROLES = Path(__file__).parent / "load_roles.py"

MB = 10**6


def start(bus: Bus, role: str, **env: str) -> Process:
    """A process of load_roles.py, ready."""
    process = bus.start_command([sys.executable, str(ROLES), role], env=env)
    process.wait_for_line("ready")
    return process


@pytest.fixture
def node(bus: Bus) -> Node:
    return bus.node("test")


@pytest.fixture
def listener(node: Node) -> TransformListener:
    return TransformListener(Buffer(), node)


def answer(client: Client, request: object) -> Any:
    """What a service answers; asked again where the link to it was lost, as it may be on a machine
    that is as busy as these tests make it.
    """

    def response() -> Any:
        try:
            return client.call(request, timeout_s=DEADLINE_S)
        except ServiceError:
            return None

    return eventually(response)


def load(node: Node, **asked: float) -> Load.Response:
    """Ask the publisher for it, and wait until it is sent."""
    response: Load.Response = answer(node.create_client(Load, "load"), Load.Request(**asked))
    return response


def not_counted(report: Report.Response) -> float:
    """How many of the sends up to the newest that was heard are neither counted as received nor as
    missed.
    """
    return report.x + 1 - report.messages - report.missed


def after(listener: TransformListener, number: int) -> Report.Response:
    """What the listener has received by the time it knows of a send after this one."""
    return eventually(lambda: report if (report := heard(listener)).x > number else None)


def test_ten_thousand_frames_come_in_one_send(bus: simulated_bus.Bus, sender: Node) -> None:
    """A send of 10,000 frames is one message, and puts all of them into the buffer."""
    broadcaster = TransformBroadcaster(sender)
    with TransformListener(Buffer(), bus.node("test")) as listener:
        send_until(
            lambda: broadcaster.send_transform(batch(7, 10_000)),
            lambda: len(listener.buffer.frames()) == 10_001,
        )
        assert x_of(listener.buffer, "frame_9999") == 7.0
        broadcaster.send_transform(batch(8, 10_000))
        eventually(lambda: x_of(listener.buffer, "frame_0") == 8.0)
        assert x_of(listener.buffer, "frame_9999") == 8.0


@pytest.mark.real
def test_each_send_of_a_burst_comes_or_is_counted_as_missed(
    bus: Bus, node: Node, listener: TransformListener
) -> None:
    """Of 10,000 sends in a row each one is received, or counted as missed."""
    start(bus, "publish")
    before = after(listener, 0)
    burst = load(node, sends=10_000)
    report = after(listener, burst.number)
    assert not_counted(report) == not_counted(before)
    assert report.messages > before.messages


@pytest.mark.real
def test_a_stopped_subscriber_does_not_hold_up_others_and_counts_what_it_missed(
    bus: Bus, node: Node, listener: TransformListener
) -> None:
    """While a subscriber is stopped the publisher goes on, without piling up what it sends, and
    all others hear it; afterwards the subscriber knows how much it missed, and has missed no
    static transform.
    """
    # Where a subscriber takes nothing for seconds Zenoh gives its link up; without multicast it
    # reconnects soonest to an endpoint that --connect names.
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    publisher = start(bus, "publish", TFBUS_LISTEN=endpoint)
    slow = start(bus, "listen", TFBUS_CONNECT=f"{bus.endpoint},{endpoint}")
    client = node.create_client(Report, "report")

    def slow_report() -> Report.Response:
        report: Report.Response = answer(client, Report.Request())
        return report

    before = eventually(lambda: report if (report := slow_report()).x > 0 else None)
    load(node, static_x=1.0)
    eventually(lambda: slow_report().static_x == 1.0)
    former = memory(publisher.pid)
    slow.signal(signal.SIGSTOP)
    try:
        sent = load(node, sends=2_000, frames=200, static_x=2.0)
        eventually(lambda: heard(listener).static_x == 2.0)
        assert after(listener, sent.number).messages > before.messages
        assert sent.memory - former < 100 * MB
    finally:
        slow.signal(signal.SIGCONT)
    report = eventually(
        lambda: report if (report := slow_report()).x > sent.number else None,
    )
    assert not_counted(report) == not_counted(before)
    assert report.missed > 0
    eventually(lambda: slow_report().static_x == 2.0)


@pytest.mark.real
def test_fifteen_thousand_sends_come_or_are_counted_also_where_a_subscriber_is_slow(
    bus: Bus, node: Node
) -> None:
    """With 15,000 sends, 5,000 a second or what the machine can, nothing grows, neither where they
    are sent nor where they are taken; who is fast enough and who is not know of each send that it
    came or was missed, and both have the static transforms.
    """
    listener = TransformListener(Buffer(cache_time_s=0.5), node)
    publisher = start(bus, "publish")
    start(bus, "dawdle")
    client = node.create_client(Report, "report")

    def slow_report() -> Report.Response:
        report: Report.Response = answer(client, Report.Request())
        return report

    slow_before = eventually(lambda: report if (report := slow_report()).x > 0 else None)
    before = after(listener, load(node, sends=2_000, frames=30, rate=5_000.0).number)
    former, former_here = memory(publisher.pid), memory()

    def sent_until_missed() -> Load.Response | None:
        # A machine that sends slower than the slow one takes sends on, as fast as it can.
        sent = load(node, sends=15_000, frames=30, rate=5_000.0, static_x=3.0)
        return sent if slow_report().missed > slow_before.missed else None

    sent = eventually(sent_until_missed)
    report = after(listener, sent.number)
    assert not_counted(report) == not_counted(before)
    slow = eventually(
        lambda: report if (report := slow_report()).x > sent.number else None,
    )
    assert not_counted(slow) == not_counted(slow_before)
    grown = sent.memory - former, memory() - former_here, slow.memory - slow_before.memory
    assert max(grown) < 50 * MB
    eventually(lambda: heard(listener).static_x == 3.0)
    eventually(lambda: slow_report().static_x == 3.0)
