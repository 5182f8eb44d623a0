"""Peers without multicast that lose a link: they meet again."""

import logging
import signal
import socket
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import zenoh
from conftest import Bus, eventually
from hosts import ROUTER_HOST, Network, why_not
from test_gone_hosts import frames

from tfbus import lost_links
from tfbus.lost_links import LostLinks, answers

REASON = why_not()
needs_hosts = pytest.mark.skipif(bool(REASON), reason=REASON or "-")

# The link is silent for 1.5 s, tokens are lost, and all of it on a busy machine.
NOTICED_WITHIN_S = 8.0
# A look within 8 s, 5 s of patience, a guest, and all of it once more where it came too early.
HEALED_WITHIN_S = 60.0


class Peers:
    """A publisher on one host and a listener on another, who know each other by a third only."""

    def __init__(self, network: Network, folder: Path, *, router: bool) -> None:
        config = folder / "no_multicast.json5"
        config.write_text("{scouting: {multicast: {enabled: false}}}")
        env = {"TFBUS_CONFIG": str(config)}
        if router:
            network.start_router(env=env)
        else:
            listening = env | {"TFBUS_LISTEN": "tcp/0.0.0.0:7447"}
            network.start(ROUTER_HOST, "fault_witness.py", "third", env=listening)
        called = env | {"TFBUS_CONNECT": network.router}
        self.listener = network.start("desk", "fault_witness.py", "listener", env=called)
        self.publisher = network.start(
            "robot", "stream_publisher.py", "sim", "--moving", "robot", env=called
        )

    def robot_is(self, *, gone: bool) -> Callable[[], bool]:
        """Whether the listener knows the frame, so, and where it is not gone that it moves."""

        def told() -> bool:
            robot = frames(self.listener).get("robot", {})
            return robot.get("gone") is gone and (gone or robot["age_s"] < 1.0)

        return told


@pytest.fixture
def network(bus: Bus) -> Iterator[Network]:
    network = Network(bus, "robot", "desk")
    yield network
    network.close()


def test_who_has_ended_is_not_looked_for() -> None:
    """A port that refuses is that of a process that ended; one that answers, of one that lives."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        endpoint = f"tcp/127.0.0.1:{server.getsockname()[1]}"
        assert answers(endpoint) is True
    assert answers(endpoint) is False
    assert answers("udp/127.0.0.1:7447") is False


def test_a_third_is_hung_up_on_three_times_at_most(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where a peer answers and is not met all the same, the third is left alone after a while."""
    monkeypatch.setattr(lost_links, "_LOOK_EVERY_S", (0.001, 0.002))
    monkeypatch.setattr(lost_links, "_MEETS_WITHIN_S", 0.001)
    listening: list[Any] = []
    hung_up: list[float] = []

    def listen(callback: Any) -> object:
        listening.append(callback)
        return SimpleNamespace(undeclare=lambda: None)

    def links() -> list[object]:
        hung_up.append(time.monotonic())
        return []

    info = SimpleNamespace(
        declare_link_events_listener=listen,
        links=links,
        peers_zid=list,
        routers_zid=list,
    )
    config = zenoh.Config()
    config.insert_json5("connect/endpoints", '["tcp/127.0.0.1:7447"]')
    session: Any = SimpleNamespace(info=info)
    lost = LostLinks(session, config, logging.getLogger("test"))
    with socket.create_server(("127.0.0.1", 0)) as server:
        link = SimpleNamespace(zid="f00", dst=f"tcp/127.0.0.1:{server.getsockname()[1]}")
        listening[0](SimpleNamespace(kind=zenoh.SampleKind.DELETE, link=link))
        eventually(lambda: len(hung_up) == 3)
        # Another that is lost later is looked for: so the first has had its turns.
        link.zid = "f01"
        listening[0](SimpleNamespace(kind=zenoh.SampleKind.DELETE, link=link))
        eventually(lambda: len(hung_up) == 6)
    lost.close()
    assert len(hung_up) == 6


@needs_hosts
@pytest.mark.parametrize("router", [False, True], ids=["by a peer", "by a router"])
def test_two_peers_that_lost_only_each_other_meet_again(
    network: Network, tmp_path: Path, router: bool
) -> None:
    """Two peers that a third introduced lose their link for a while, and not that with the third:
    they meet again, though nobody introduces them a second time.
    """
    peers = Peers(network, tmp_path, router=router)
    eventually(peers.robot_is(gone=False))
    network.hosts.set_way("robot", "desk", up=False)
    eventually(peers.robot_is(gone=True), within_s=NOTICED_WITHIN_S)
    network.hosts.set_way("robot", "desk", up=True)
    eventually(peers.robot_is(gone=False), within_s=HEALED_WITHIN_S)


@needs_hosts
def test_a_host_that_was_unplugged_is_met_again_without_multicast(
    network: Network, tmp_path: Path
) -> None:
    """Whoever was cut off calls the third again, and is introduced to all by it."""
    peers = Peers(network, tmp_path, router=False)
    for host in ("robot", "desk"):
        eventually(peers.robot_is(gone=False), within_s=HEALED_WITHIN_S)
        network.hosts.set_link(host, up=False)
        eventually(peers.robot_is(gone=True), within_s=NOTICED_WITHIN_S)
        network.hosts.set_link(host, up=True)
    eventually(peers.robot_is(gone=False), within_s=HEALED_WITHIN_S)


@needs_hosts
def test_a_process_that_stood_still_is_met_again_without_multicast(
    network: Network, tmp_path: Path
) -> None:
    """A process that a busy machine did not let run for longer than the lease is back after it."""
    peers = Peers(network, tmp_path, router=False)
    eventually(peers.robot_is(gone=False))
    peers.publisher.signal(signal.SIGSTOP)
    eventually(peers.robot_is(gone=True), within_s=NOTICED_WITHIN_S)
    peers.publisher.signal(signal.SIGCONT)
    eventually(peers.robot_is(gone=False), within_s=HEALED_WITHIN_S)
