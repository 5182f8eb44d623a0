"""Peers without multicast that lose a link: they meet again."""

import json
import logging
import signal
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import zenoh

from tests import needs
from tests.hosts.network import ROUTER_HOST, Network, frames
from tests.live_bus import DEADLINE_S, Bus, eventually, free_port
from tfbus import NodeSettings
from tfbus.bus import lost_links
from tfbus.bus.lost_links import LostLinks, addresses, who_answers
from tfbus.bus.session import Session

REASON = needs.why_no_hosts()
needs_hosts = pytest.mark.skipif(bool(REASON), reason=REASON or "-")

# The link is silent for 1.5 s, tokens are lost, and all of it on a busy machine.
NOTICED_WITHIN_S = 8.0
# A look within 6 s, 5 s of patience, a hang-up, and all of it once more where it came too early.
HEALED_WITHIN_S = 60.0


class Peers:
    """A publisher on one host and a listener on another, introduced by one that both name."""

    def __init__(self, network: Network, folder: Path, *, router: bool) -> None:
        config = folder / "no_multicast.json5"
        config.write_text("{scouting: {multicast: {enabled: false}}}")
        env = {"TFBUS_CONFIG": str(config)}
        if router:
            network.start_router(env=env)
        else:
            listening = env | {"TFBUS_LISTEN": "tcp/0.0.0.0:7447"}
            network.start(ROUTER_HOST, "fault_witness.py", "named", env=listening)
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


def link(peer: str, endpoint: str, source: str = "tcp/127.0.0.1:1") -> Any:
    """A link to a peer, as Zenoh tells it."""
    return SimpleNamespace(zid=peer, src=source, dst=endpoint)


class Known:
    """What looks for lost peers, with made-up links, and who it would have hung up on."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *named: str) -> None:
        monkeypatch.setattr(lost_links, "_LOOK_EVERY_S", (0.001, 0.002))
        monkeypatch.setattr(lost_links, "_MEETS_WITHIN_S", 0.001)
        monkeypatch.setattr(lost_links, "_HANG_UP_EVERY_S", 0.001)
        monkeypatch.setattr(lost_links, "shut", lambda port, remote: self.hung_up.append(remote))
        config = zenoh.Config()
        config.insert_json5("connect/endpoints", json.dumps(named or ["tcp/127.0.0.1:7447"]))
        self.links = [link("abc", "tcp/127.0.0.1:7447")]
        self.hung_up: list[tuple[str, int]] = []
        info: Any = SimpleNamespace(links=lambda: self.links)
        self.lost = LostLinks(info, config, logging.getLogger("test"))

    def lose(self, *lost: Any) -> None:
        """Lose some links, all before the first look."""
        go_on, done = threading.Event(), threading.Event()

        def wait() -> None:
            go_on.wait()

        self.lost._executor.submit("wait", wait)
        for each in lost:
            event: Any = SimpleNamespace(kind=zenoh.SampleKind.DELETE, link=each)
            self.lost.on_link(event)
        self.lost._executor.submit("done", done.set)
        go_on.set()
        assert done.wait(DEADLINE_S)

    def gave_up(self) -> bool:
        """Whether nobody is looked for any more."""
        return not self.lost._lost


@pytest.fixture
def known(monkeypatch: pytest.MonkeyPatch) -> Iterator[Known]:
    known = Known(monkeypatch)
    yield known
    known.lost.close()


@pytest.fixture
def listening() -> Iterator[str]:
    """The endpoint of somebody that answers."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        yield f"tcp/127.0.0.1:{server.getsockname()[1]}"


def test_who_has_ended_is_not_looked_for(listening: str) -> None:
    """A port that refuses is that of a process that ended; one that answers, of one that lives."""
    (address,) = addresses(listening)
    ended = ("127.0.0.1", free_port())
    assert who_answers([address, ended], 5.0) == {address: True, ended: False}


def test_only_links_of_tcp_are_looked_for(known: Known, caplog: pytest.LogCaptureFixture) -> None:
    """A link of another protocol is told of once, for debugging, and left alone."""
    caplog.set_level(logging.DEBUG)
    known.lose(link("f00", "udp/127.0.0.1:7460"), link("f01", "udp/127.0.0.1:7461"))
    assert caplog.messages == [
        "Lost the link to udp/127.0.0.1:7460; without multicast it is not looked for, "
        "as that takes TCP and Linux"
    ]


def test_the_named_one_is_hung_up_on_three_times_at_most(known: Known, listening: str) -> None:
    """Where a peer answers and is not met all the same, the named one is left alone after that."""
    known.lose(link("f00", listening))
    eventually(known.gave_up)
    assert len(known.hung_up) == 3
    # Another that is lost later is looked for: so the first has had its turns.
    known.lose(link("f01", listening))
    eventually(known.gave_up)
    assert len(known.hung_up) == 6


def test_many_lost_peers_have_three_hang_ups_between_them(known: Known) -> None:
    """One hang-up is for all that are lost, however many they are."""
    with ExitStack() as servers:
        ports = [
            servers.enter_context(socket.create_server(("127.0.0.1", 0))).getsockname()[1]
            for _ in range(20)
        ]
        known.lose(*[link(f"f{port}", f"tcp/127.0.0.1:{port}") for port in ports])
        eventually(known.gave_up)
    assert known.hung_up == [("127.0.0.1", 7447)] * 3


def test_a_restarted_peer_counts_as_met(known: Known, listening: str) -> None:
    """A peer that is linked at the endpoint of the lost one is that peer, whatever its id."""
    known.links.append(link("f01", listening))
    known.lose(link("f00", listening))
    eventually(known.gave_up)
    assert known.hung_up == []


def test_a_restarted_peer_that_has_called_costs_one_hang_up(
    monkeypatch: pytest.MonkeyPatch, known: Known, listening: str
) -> None:
    """Where somebody of the lost one's host has come since, it may be that: once is enough."""
    monkeypatch.setattr(lost_links, "_MEETS_WITHIN_S", 0.2)
    known.lose(link("f00", listening))
    known.links.append(link("f01", "tcp/127.0.0.1:60001"))
    eventually(known.gave_up)
    assert len(known.hung_up) == 1


def test_a_named_one_that_is_lost_is_left_to_zenoh(
    monkeypatch: pytest.MonkeyPatch, listening: str
) -> None:
    """Whoever is named by a host's name is the same at that host's address."""
    known = Known(monkeypatch, listening.replace("127.0.0.1", "localhost"))
    # Whoever is looked for is known until the first look.
    monkeypatch.setattr(lost_links, "_LOOK_EVERY_S", (600.0, 600.0))
    known.lose(link("f00", listening))
    assert known.gave_up()
    known.lost.close()


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost"])
def test_nobody_hangs_up_where_a_peer_is_restarted(
    host: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """A peer that starts again at the port that it had is met as others are: by an introduction."""
    made: list[LostLinks] = []
    hung_up: list[object] = []

    def make(*arguments: Any) -> LostLinks:
        made.append(LostLinks(*arguments))
        return made[-1]

    # The looks begin when it is back.
    monkeypatch.setattr(lost_links, "_LOOK_EVERY_S", (3.0, 3.0))
    monkeypatch.setattr(lost_links, "shut", lambda *link: hung_up.append(link))
    monkeypatch.setattr("tfbus.bus.session.LostLinks", make)
    named, port = f"tcp/{host}:{free_port()}", free_port()
    with ExitStack() as sessions:

        def start(name: str, **settings: Any) -> Session:
            config = tmp_path / f"{name}.json5"
            # The one of the greater id calls.
            zid = {"us": "f" * 32, "peer": f"{len(made) + 1}"}.get(name, "e")
            config.write_text(f"{{id: '{zid}', scouting: {{multicast: {{enabled: false}}}}}}")
            session = Session(
                NodeSettings(name, config=str(config), **settings), logging.getLogger(name)
            )
            sessions.callback(session.close)
            return session

        def is_linked() -> bool:
            return any(
                each.zid == peer.zenoh.zid() and each.dst.endswith(f":{port}")
                for each in us.zenoh.info.links()
            )

        at = {"listen": (f"tcp/127.0.0.1:{port}",), "connect": (named,)}
        start("named", listen=(named,))
        us = start("us", connect=(named,), listen=("tcp/127.0.0.1:0",))
        lost = made[-1]
        peer = start("peer", **at)
        eventually(is_linked)
        peer.close()
        peer = start("peer", **at)
        eventually(is_linked)
        eventually(lambda: not lost._lost)
    assert hung_up == []


@needs_hosts
@pytest.mark.parametrize("router", [False, True], ids=["by a peer", "by a router"])
def test_two_peers_that_lost_only_each_other_meet_again(
    network: Network, tmp_path: Path, router: bool
) -> None:
    """Two peers that the named one introduced lose their link for a while, and keep those with it:
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
    """Whoever was cut off calls the named one again, and is introduced to all by it."""
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
