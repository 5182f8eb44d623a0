"""Links that were opened and are never read."""

import logging
import socket
from collections.abc import Iterator
from contextlib import ExitStack
from typing import Any

import pytest
import zenoh

from tests.buses import DEADLINE_S
from tfbus.base import scheduler
from tfbus.bus.deaf_links import DeafLinks
from tfbus.bus.neighbours import Neighbours
from tfbus.bus.settings import LAN
from tfbus.bus.zenoh_sockets import Ends, Received, ZenohSockets, received_by

ONE, OTHER = ("10.0.0.1:4000", "10.0.0.2:7447"), ("10.0.0.1:4001", "10.0.0.2:7447")
LEASE_S = 1.5


class Looks:
    """Looks at links, at times that the test gives."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *links: Ends) -> None:
        self.now_s = 0.0
        monkeypatch.setattr(scheduler, "monotonic", lambda: self.now_s)
        self.links = DeafLinks(LEASE_S)
        self.links.watch(set(links))

    def look(self, after_s: float = LEASE_S, **received: tuple[int, int]) -> set[Ends]:
        """Look after so much time, of links that have read so much and have so much waiting."""
        self.now_s += after_s
        names = {"one": ONE, "other": OTHER}
        return self.links.look({names[name]: Received(*has) for name, has in received.items()})


@pytest.fixture
def looks(monkeypatch: pytest.MonkeyPatch) -> Looks:
    return Looks(monkeypatch, ONE, OTHER)


def test_a_link_is_deaf_that_reads_nothing_for_three_leases(looks: Looks) -> None:
    """Bytes wait, and none was read: once, and it is looked at no more."""
    for waiting in (4, 8, 12):
        assert looks.look(one=(50, waiting), other=(50, 0)) == set()
    assert looks.look(one=(50, 16), other=(50, 0)) == {ONE}
    assert looks.links.links == {OTHER}


def test_a_link_that_was_read_is_looked_at_no_more(looks: Looks) -> None:
    """However much waits: its reader is busy, and Zenoh ends the link if it stays silent."""
    looks.look(one=(50, 4), other=(50, 4))
    assert looks.look(one=(54, 900), other=(54, 0)) == set()
    assert looks.links.next_s is None


def test_a_silent_link_is_not_deaf(looks: Looks) -> None:
    """Nothing waits: whether the far end is there is for the lease to say."""
    for _ in range(20):
        assert looks.look(one=(50, 0), other=(50, 0)) == set()


def test_a_link_that_is_gone_is_looked_at_no_more(looks: Looks) -> None:
    """Zenoh has ended it, or another one."""
    looks.look(one=(50, 4), other=(50, 4))
    assert looks.look() == set()
    assert looks.links.next_s is None


def test_a_process_that_stood_still_reads_later(looks: Looks) -> None:
    """The time in which it could not look does not count: neither could it read."""
    looks.look(one=(50, 4))
    assert looks.look(60.0, one=(50, 40)) == set()
    for _ in range(2):
        assert looks.look(one=(50, 40)) == set()
    assert looks.look(one=(50, 40)) == {ONE}


class Session:
    """A session as far as its neighbours need it: it tells of one link."""

    def __init__(self, one: socket.socket) -> None:
        self.info = self
        here, far = (f"tcp/{host}:{port}" for host, port in (one.getsockname(), one.getpeername()))
        self.src, self.dst, self.zid = here, far, "a1"
        self.transport = self.link = self
        self.kind = zenoh.SampleKind.PUT

    def _tell(self, handler: Any, history: bool) -> Any:
        handler.callback(self)
        return self

    declare_transport_events_listener = declare_link_events_listener = _tell

    def undeclare(self) -> None:
        """Nothing was declared."""


@pytest.fixture
def link() -> Iterator[tuple[socket.socket, socket.socket]]:
    """Both ends of a connection."""
    with ExitStack() as stack:
        server = stack.enter_context(socket.create_server(("127.0.0.1", 0)))
        near = stack.enter_context(socket.create_connection(server.getsockname()))
        far = stack.enter_context(server.accept()[0])
        far.settimeout(DEADLINE_S)
        yield near, far


@pytest.mark.real
def test_the_system_says_what_was_read(link: tuple[socket.socket, socket.socket]) -> None:
    """All that has come, in two parts, of the links that were asked about."""
    near, far = link
    far.sendall(b"12345678")
    assert near.recv(3, socket.MSG_WAITALL) == b"123"
    near.recv(5, socket.MSG_WAITALL | socket.MSG_PEEK)
    here, there = (f"127.0.0.1:{one.getsockname()[1]}" for one in link)
    assert received_by({(here, there)}) == {(here, there): Received(3, 5)}


@pytest.mark.real
def test_a_session_ends_a_deaf_link(
    link: tuple[socket.socket, socket.socket], caplog: pytest.LogCaptureFixture
) -> None:
    """The far end hears that the connection is over, and the log says so once."""
    near, far = link
    far.sendall(b"a keep-alive")
    session: Any = Session(near)
    log = logging.getLogger("deaf")
    neighbours = Neighbours(session, None, ZenohSockets(), 0.02, LAN, (), log, "")
    try:
        assert far.recv(1) == b""
    finally:
        neighbours.close()
    (said,) = [each.getMessage() for each in caplog.records]
    assert said.startswith("Nothing that came by the link to 127.0.0.1:")
