"""Zenoh's own sockets: those that a session has opened, which Zenoh does not tell."""

import os
import socket
import stat
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import NamedTuple, TypeVar

T = TypeVar("T")

_FILES = "/proc/self/fd"

# Two sessions that open at once would take each other's sockets for their own.
_opening = threading.Lock()


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


def end_link(src: str, dst: str) -> None:
    """End the connection of TCP between two addresses such as `10.0.0.1:7447`; Zenoh then takes
    the link for lost, as the other process does. Nothing if there is none.
    """
    for each in _sockets(_files()):
        with each, suppress(OSError):
            if each.type == socket.SOCK_STREAM and _ends(each) == (src, dst):
                each.shutdown(socket.SHUT_RDWR)


def _ends(one: socket.socket) -> tuple[str, str]:
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
