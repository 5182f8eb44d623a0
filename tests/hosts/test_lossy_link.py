"""The bad link of the tests follows its settings: it delays, loses, queues and is away."""

import json
import random
import re
import statistics
import sys
from collections.abc import Iterator

import pytest

from tests import needs
from tests.buses import DEADLINE_S, eventually
from tests.hosts.lossy_link import Conditions, Way
from tests.hosts.network import Hosts
from tests.live_bus import Bus

PACKETS = 20_000
APART_S = 0.001


def arrivals(conditions: Conditions, size: int = 1000) -> list[float | None]:
    """How long each of many packets takes that are sent one a millisecond; None for one lost."""
    way = Way(random.Random(1).random, conditions)
    due = [(way.arrival_s(size, n * APART_S), n * APART_S) for n in range(PACKETS)]
    return [None if at_s is None else at_s - sent_s for at_s, sent_s in due]


def test_packets_take_the_delay_and_overtake_none() -> None:
    """Packets are delayed by what is said, more or less by the jitter, and arrive in order."""
    took = arrivals(Conditions(delay_s=0.06, jitter_s=0.03))
    arrived = [n * APART_S + each for n, each in enumerate(took) if each is not None]
    assert len(arrived) == PACKETS and arrived == sorted(arrived)
    assert all(0.03 <= each <= 0.09 for each in took if each is not None)


@pytest.mark.parametrize("burst", [1.0, 3.0])
def test_packets_are_lost_one_by_one_or_in_a_row(burst: float) -> None:
    """The share of packets that is lost, and how many in a row, are as said."""
    lost = "".join(
        "x" if each is None else "." for each in arrivals(Conditions(loss=0.1, burst=burst))
    )
    assert lost.count("x") / PACKETS == pytest.approx(0.1, abs=0.01)
    rows = [len(each) for each in re.findall("x+", lost)]
    assert statistics.fmean(rows) == pytest.approx(max(burst, 1 / 0.9), rel=0.1)


def test_a_narrow_link_queues_and_drops_what_waits_for_too_long() -> None:
    """On a link that is too narrow packets wait for as long as its queue, and no more pass than its
    bandwidth.
    """
    took = arrivals(Conditions(bytes_a_second=500_000.0, queue_s=0.2))
    passed = [each for each in took if each is not None]
    assert len(passed) / PACKETS == pytest.approx(0.5, abs=0.02)
    assert max(passed) == pytest.approx(0.2, abs=0.01)


def test_nothing_arrives_while_a_link_is_down() -> None:
    """A link that is down carries nothing."""
    assert set(arrivals(Conditions(is_up=False))) == {None}


REASON = needs.why_no_hosts()


@pytest.fixture
def hosts() -> Iterator[Hosts]:
    hosts = Hosts("robot", "desk", offline=("robot", "desk"))
    yield hosts
    hosts.close()


# A host that sends back what comes, and one that says how long each packet took; None if lost.
ECHO = """
import socket
echo = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
echo.bind(("", 7000))
print("ready", flush=True)
while True:
    echo.sendto(*echo.recvfrom(100))
"""
ASK = """
import json, socket, sys, time
ask = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
ask.settimeout(float(sys.argv[2]))
took = []
for _ in range(3):
    began = time.monotonic()
    ask.sendto(b"ping", (sys.argv[1], 7000))
    try:
        ask.recv(100)
        took.append(time.monotonic() - began)
    except TimeoutError:
        took.append(None)
print(json.dumps(took))
"""


@pytest.mark.real
@pytest.mark.skipif(bool(REASON), reason=REASON or "-")
def test_hosts_reach_each_other_by_a_bad_link(hosts: Hosts, bus: Bus) -> None:
    """Two hosts without any other network reach each other by the link, with its delay both ways,
    until it is down.
    """
    link = hosts.join_by_link("robot", "desk", Conditions(delay_s=0.1, jitter_s=0.02))
    bus.start_command(hosts.command("desk", sys.executable, "-c", ECHO)).wait_for_line("ready")

    def ask(within_s: float) -> list[float | None]:
        asked = hosts.link_address["desk"], str(within_s)
        asking = bus.start_command(hosts.command("robot", sys.executable, "-c", ASK, *asked))
        assert asking.wait() == 0
        took: list[float | None] = json.loads(asking.out[-1])
        return took

    assert all(each is not None and each >= 0.16 for each in ask(DEADLINE_S))
    there, back = link.counts()
    assert (there.packets, there.lost, back.packets) == (3, 0, 3)
    link.set(Conditions(is_up=False))
    assert ask(0.5) == [None] * 3
    eventually(lambda: link.counts()[0].lost == 3)
