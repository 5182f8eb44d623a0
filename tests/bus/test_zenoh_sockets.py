"""Sockets of sessions: which of a process's own a session has opened."""

import os
import select
import socket
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing, suppress
from types import SimpleNamespace
from typing import Any

import pytest

from tests.buses import DEADLINE_S
from tfbus.bus.zenoh_sockets import (
    SocketMarks,
    ZenohSockets,
    admit_datagrams,
    end_datagrams,
    hold_back,
    take_more,
    with_sockets,
)

pytestmark = pytest.mark.real

# A port of its own: other processes of this machine may scout.
GROUP = ("224.0.0.224", 7559)
MARKS = SocketMarks(listening=("127.0.0.1",), group=GROUP, ttl=1, interfaces=1)


@pytest.fixture
def closed_at_the_end() -> Iterator[ExitStack]:
    """A stack that closes the sockets of a test."""
    with ExitStack() as stack:
        yield stack


def opened(stack: ExitStack, kind: int, address: tuple[str, int]) -> socket.socket:
    one = stack.enter_context(socket.socket(socket.AF_INET, kind))
    one.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    one.bind(address)
    if kind == socket.SOCK_STREAM:
        one.listen()
    return one


def connected(stack: ExitStack, *, window: int) -> tuple[socket.socket, socket.socket]:
    """The two ends of a link of TCP; the second was opened with a window of so many bytes."""
    listening = opened(stack, socket.SOCK_STREAM, ("127.0.0.1", 0))
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, window)
    one = stack.enter_context(socket.create_connection(listening.getsockname()))
    other, _ = listening.accept()
    return one, stack.enter_context(other)


def like_zenoh(stack: ExitStack) -> SimpleNamespace:
    """Sockets as a session of Zenoh has them that scouts on loopback alone."""
    asking = opened(stack, socket.SOCK_DGRAM, ("0.0.0.0", 0))
    asking.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton("127.0.0.1"))
    return SimpleNamespace(
        listening=opened(stack, socket.SOCK_STREAM, ("127.0.0.1", 0)),
        answering=opened(stack, socket.SOCK_DGRAM, GROUP),
        asking=asking,
    )


def ports(one: Any) -> tuple[list[int], list[int]]:
    if isinstance(one, ZenohSockets):
        return list(one.listening), list(one.asking)
    return [one.listening.getsockname()[1]], [one.asking.getsockname()[1]]


def inode(one: socket.socket | None) -> int:
    assert one is not None
    return os.fstat(one.fileno()).st_ino


def test_a_session_opens_while_another_is_being_opened(closed_at_the_end: ExitStack) -> None:
    """The second session of a process does not wait until the first is open, which may take a
    second, and each knows its own sockets.
    """
    has_sockets, may_return = threading.Event(), threading.Event()

    def open_slowly() -> SimpleNamespace:
        ours = like_zenoh(closed_at_the_end)
        has_sockets.set()
        assert may_return.wait(DEADLINE_S)
        return ours

    with ThreadPoolExecutor() as pool:
        first = pool.submit(with_sockets, open_slowly, MARKS)
        assert has_sockets.wait(DEADLINE_S)
        second = pool.submit(with_sockets, lambda: like_zenoh(closed_at_the_end), MARKS)
        try:
            results = [second.result(DEADLINE_S)]
        finally:
            may_return.set()
        results.append(first.result(DEADLINE_S))
    for ours, found in results:
        closed_at_the_end.enter_context(found.answering)
        assert ports(found) == ports(ours)
        assert inode(found.answering) == inode(ours.answering)


def test_sockets_of_the_program_are_not_taken_for_zenohs(closed_at_the_end: ExitStack) -> None:
    """Sockets that another thread of the program opens meanwhile are left alone: of UDP, of
    multicast, and servers.
    """

    def open_beside_others() -> SimpleNamespace:
        opened(closed_at_the_end, socket.SOCK_DGRAM, ("0.0.0.0", 0))
        of_dds = opened(closed_at_the_end, socket.SOCK_DGRAM, ("0.0.0.0", 0))
        of_dds.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton("127.0.0.1"))
        of_dds.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 32)
        opened(closed_at_the_end, socket.SOCK_STREAM, ("0.0.0.0", 0))
        return like_zenoh(closed_at_the_end)

    ours, found = with_sockets(open_beside_others, MARKS)
    closed_at_the_end.enter_context(found.answering)
    assert ports(found) == ports(ours)


def test_datagrams_are_heard_of_some_hosts_alone() -> None:
    """A socket at a port hears the hosts that it is told, of others at most what ends a session,
    until it is told anew.
    """
    with closing(socket.socket(socket.AF_INET6, socket.SOCK_DGRAM)) as listening:
        listening.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 0)
        listening.bind(("::", 0))
        listening.settimeout(10.0)
        port = listening.getsockname()[1]

        def send(host: str, payload: bytes = b"") -> None:
            with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as sender:
                sender.bind((host, 0))
                sender.sendto(payload or host.encode(), ("127.0.0.1", port))

        assert admit_datagrams(port, ["127.0.0.3", "fe80::1"]) == ""
        send("127.0.0.2")
        send("127.0.0.3")
        assert listening.recv(100) == b"127.0.0.3"
        admit_datagrams(port, ["127.0.0.2", "127.0.0.4"])
        send("127.0.0.3")
        send("127.0.0.4")
        assert listening.recv(100) == b"127.0.0.4"
        admit_datagrams(port, ["127.0.0.4"], ["127.0.0.3"])
        begin, close = b"\x01begins", b"\x23\x00"
        for host in ("127.0.0.2", "127.0.0.3"):
            send(host, begin)
            send(host, close)
        send("127.0.0.4", begin)
        assert [listening.recv(100) for _ in range(2)] == [close, begin]
    assert "not found" in admit_datagrams(port, ["127.0.0.2"])


def test_a_session_of_datagrams_ends_here_before_there() -> None:
    """Nothing of the session follows what ends it, which is sent twice at once."""
    with ExitStack() as closed:
        of_zenoh, far = (
            closed.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) for _ in range(2)
        )
        for each in (of_zenoh, far):
            each.bind(("127.0.0.1", 0))
            each.settimeout(10.0)
        of_zenoh.connect(far.getsockname())
        here, there = ("{}:{}".format(*each.getsockname()) for each in (of_zenoh, far))
        end_datagrams({(here, there)})
        assert of_zenoh.recv(100) == b"\x23\x00"
        assert [far.recv(100) for _ in range(2)] == [b"\x23\x00"] * 2
        with suppress(OSError):
            of_zenoh.send(b"a frame")
        far.settimeout(0.0)
        with pytest.raises(BlockingIOError):
            far.recv(100)


def test_tcp_takes_little_that_it_cannot_send(closed_at_the_end: ExitStack) -> None:
    """Of a link that is held back TCP takes more bytes only while little waits to be sent."""
    # Linux lets the far end take more and more, as it reads, unless it is told how much.
    one, other = connected(closed_at_the_end, window=65536)
    taken = {}
    for unsent_bytes in (None, 4096):
        if unsent_bytes is not None:
            here, there = (":".join(map(str, end())) for end in (one.getsockname, one.getpeername))
            hold_back({(here, there)}, unsent_bytes)
            while other.recv(2**20, socket.MSG_DONTWAIT):
                if not select.select([other], [], [], 0.1)[0]:
                    break
        one.setblocking(False)
        taken[unsent_bytes] = 0
        with suppress(BlockingIOError):
            while True:
                taken[unsent_bytes] += one.send(bytes(65536))
    assert taken[4096] < taken[None]


def test_a_link_takes_more_than_it_was_opened_with(closed_at_the_end: ExitStack) -> None:
    """The far end sends more of what is not read yet, as soon as it has learned of it."""
    window = 16384
    one, other = connected(closed_at_the_end, window=window)

    def unread() -> int:
        for _ in range(100):
            one.sendall(bytes(8192))
            other.recv(8192, socket.MSG_WAITALL)
        one.setblocking(False)
        with suppress(BlockingIOError):
            while True:
                one.send(bytes(8192))
        one.setblocking(True)
        arrived = len(other.recv(2**20, socket.MSG_PEEK))
        while select.select([other], [], [], 0.1)[0]:
            other.recv(2**20)
        return arrived

    # Linux offers about half of the memory that it has for a window.
    assert unread() <= 2 * window
    here, there = (":".join(map(str, end())) for end in (other.getsockname, other.getpeername))
    take_more({(here, there)})
    assert unread() > 4 * window
