"""Zenoh's own sockets: those that a session has opened, which Zenoh does not tell."""

import os
import socket
import stat
import struct
from collections.abc import Callable, Container, Iterator
from contextlib import suppress
from typing import NamedTuple, TypeVar

from tfbus.runtime import scheduler

T = TypeVar("T")

# The addresses of the two ends of a connection, each as `10.0.0.1:7447`.
Ends = tuple[str, str]

_FILES = "/proc/self/fd"

_CLOSE_WITHIN_S = 1

# Two sessions that open at once would take each other's sockets for their own.
_opening = scheduler.Lock()


class ZenohSockets(NamedTuple):
    """The sockets of one session: the ports of TCP that it listens on, the ports of UDP to which
    the answers to its Scouts come, and a copy of the socket to which the Scouts of others come.
    """

    listening: tuple[int, ...] = ()
    asking: tuple[int, ...] = ()
    answering: socket.socket | None = None


def with_sockets(open_session: Callable[[], T], group: tuple[str, int]) -> tuple[T, ZenohSockets]:
    """What `open_session()` returns, and the sockets that it has opened; `group` is the address of
    scouting.
    """
    with _opening:
        before = _files()
        opened = open_session()
        return opened, _told_apart(_sockets(_files() - before), group)


def shorten_close(links: Container[Ends]) -> None:
    """Let the close of these links wait for 1 s at most. Zenoh's default is 10 s, in which a link
    that is lost stands in the way of the next one to the same process.
    """
    for each in _connections(links):
        _set_linger(each, _CLOSE_WITHIN_S)


def end_links(links: Container[Ends]) -> None:
    """Break these links: Zenoh takes them for lost, as do the other processes."""
    for each in _connections(links):
        with suppress(OSError):  # it ends by itself just now
            _set_linger(each, 0)
            each.shutdown(socket.SHUT_RDWR)


def _connections(links: Container[Ends]) -> Iterator[socket.socket]:
    for each in _sockets(_files()):
        with each, suppress(OSError):
            if each.type == socket.SOCK_STREAM and _ends(each) in links:
                yield each


def _set_linger(one: socket.socket, seconds: int) -> None:
    one.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, seconds))


def _ends(one: socket.socket) -> Ends:
    here, there = (
        f"{address[0].removeprefix('::ffff:')}:{address[1]}"
        for address in (one.getsockname(), one.getpeername())
    )
    return here, there


def _told_apart(found: Iterator[socket.socket], group: tuple[str, int]) -> ZenohSockets:
    listening, asking, answering = [], [], None
    for each in found:
        address, port = each.getsockname()[:2]
        is_stream = each.type == socket.SOCK_STREAM
        if is_stream and each.getsockopt(socket.SOL_SOCKET, socket.SO_ACCEPTCONN):
            listening.append(port)
        elif not is_stream and address == "0.0.0.0":
            asking.append(port)
        elif not is_stream and (address, port) == group and answering is None:
            answering = each
            continue
        each.close()
    return ZenohSockets(tuple(listening), tuple(asking), answering)


def _files() -> set[int]:
    return {int(name) for name in os.listdir(_FILES)} if os.path.isdir(_FILES) else set()


def _sockets(files: set[int]) -> Iterator[socket.socket]:
    """A copy of each socket of IP among the open files."""
    for number in sorted(files):
        with suppress(OSError):  # another thread has closed it
            if stat.S_ISSOCK(os.fstat(number).st_mode):
                copy = socket.socket(fileno=os.dup(number))
                if copy.family in (socket.AF_INET, socket.AF_INET6):
                    yield copy
                else:
                    copy.close()
