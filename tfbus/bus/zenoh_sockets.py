"""Zenoh's own sockets, which a session has opened and Zenoh does not tell."""

import ctypes
import os
import socket
import stat
import struct
from collections.abc import Callable, Container, Iterable, Iterator
from contextlib import suppress
from typing import NamedTuple, TypeVar

from tfbus.base import scheduler
from tfbus.base.structs import Struct

T = TypeVar("T")

# The addresses of the two ends of a connection, each as `10.0.0.1:7447`.
Ends = tuple[str, str]

_FILES = "/proc/self/fd"

_CLOSE_WITHIN_S = 1
_WITHIN_HOST_BYTES = 262_144

# From Linux's <linux/tcp.h>; not every Python has names for them.
_LARGEST_WINDOW = 10
_CONGESTION = 13
_UNSENT_AT_MOST = 25
_THIN_LINEAR_TIMEOUTS = 16
_LONGEST_PAUSE_MS = 44

# Its `tcpi_bytes_received`, since Linux 4.1.
_RECEIVED = struct.Struct("128xQ")

# From Linux's <asm-generic/socket.h>.
_ATTACH_FILTER = 26

# Zenoh's Close of a whole session, sent twice, since one may be lost. Not more often: a datagram
# that comes while Zenoh closes the link it is for is read by nobody, and the next one then holds up
# all that its socket would receive, for good, and the end of that process. Not later: Zenoh takes
# it for the end of a session that has begun since.
_CLOSE_SESSION = b"\x23\x00"
_TIMES = 2

# Zenoh takes up to a second to open a session, and has its sockets after some milliseconds.
_LOOK_AGAIN_S = 0.002


class ZenohSockets(Struct):
    """The sockets of one session: the ports of TCP that it listens on, the ports of UDP to which
    the answers to its Scouts come, and a copy of the socket to which the Scouts of others come.
    """

    listening: tuple[int, ...] = ()
    asking: tuple[int, ...] = ()
    answering: socket.socket | None = None


class SocketMarks(Struct):
    """Marks that tell a session's sockets from others that the process opens meanwhile.

    `listening` are the addresses at which it listens on free ports, `group` and `ttl` its Scouts'
    destination, and `interfaces` is the number of interfaces that it scouts on.
    """

    listening: Container[str]
    group: tuple[str, int]
    ttl: int
    interfaces: int


class _OpenFile(NamedTuple):
    """An open file of this process: another one may have its number later, but not its inode."""

    number: int
    inode: int


class _Opening:
    """A session that opens. Its sockets are among the files that are new until it has them all."""

    def __init__(self, marks: SocketMarks) -> None:
        self._marks = marks
        self._before = _files()
        self._new: set[_OpenFile] | None = None

    def has_its_sockets(self) -> bool:
        """Whether files that are opened from now on are others'."""
        if self._new is None:
            new = _files() - self._before
            found = _told_apart(new, self._marks)
            if found.answering is not None:
                found.answering.close()
                if len(found.asking) >= self._marks.interfaces:
                    self._new = new
        return self._new is not None

    def end(self) -> None:
        """Zenoh has opened it, or could not."""
        if self._new is None:
            self._new = _files() - self._before

    def sockets(self) -> ZenohSockets:
        """Its sockets, after the end."""
        return _told_apart(self._new or set(), self._marks)


class _Openings:
    """The sessions that are being opened: each begins when the one before has its sockets."""

    def __init__(self) -> None:
        self._lock = scheduler.Lock()
        self._last: _Opening | None = None

    def begin(self, marks: SocketMarks) -> _Opening:
        """Begin to open a session."""
        with self._lock:
            while self._last is not None and not self._last.has_its_sockets():
                scheduler.sleep(_LOOK_AGAIN_S)
            self._last = _Opening(marks)
            return self._last


_openings = _Openings()


def with_sockets(open_session: Callable[[], T], marks: SocketMarks) -> tuple[T, ZenohSockets]:
    """The session of `open_session()`, and the sockets that it has opened. Several threads may open
    sessions at once: none takes the sockets of another, nor waits until that one is open.
    """
    opening = _openings.begin(marks)
    try:
        opened = open_session()
    finally:
        opening.end()
    return opened, opening.sockets()


def shorten_close(links: Container[Ends]) -> None:
    """Let the close of these links wait for 1 s at most. Zenoh's default is 10 s, in which a link
    that is lost stands in the way of the next one to the same process.
    """
    for each in _connections(links):
        _set_linger(each, _CLOSE_WITHIN_S)


def hold_back(links: Container[Ends], unsent_bytes: int) -> None:
    """Have these links of TCP take further bytes only while fewer than so many wait to be sent.

    Linux takes up to 4 MB, and a transform that is sent then comes after all of it.
    """
    for each in _connections(links):
        with suppress(OSError):  # the system has not got it
            each.setsockopt(socket.IPPROTO_TCP, _UNSENT_AT_MOST, unsent_bytes)


def fit_to_losses(links: Container[Ends], most_bytes: int) -> None:
    """Have these links of TCP hold at most so many bytes that have not arrived, repeat lost packets
    at a steady pace if they carry little, and take no loss for a full link.

    Linux holds up to some megabytes, which a narrow link carries for minutes; it doubles the time
    before each further repetition; and it sends less after each loss.
    """
    for each in _connections(links):
        with suppress(OSError):
            # The system counts twice as much, and takes half of it for its own.
            each.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, most_bytes)
            each.setsockopt(socket.IPPROTO_TCP, _THIN_LINEAR_TIMEOUTS, 1)
        for option, value in ((_CONGESTION, b"bbr"), (_LONGEST_PAUSE_MS, 1000)):
            with suppress(OSError):  # the system has not got it: Linux 4.9, and 6.15
                each.setsockopt(socket.IPPROTO_TCP, option, value)


def take_more(links: Container[Ends]) -> None:
    """Have these links of TCP offer a window of 64 kB or more, whatever they were opened with.

    By a smaller one the sender, whose packets within a host have up to 64 kB, often waits until
    all that it has sent is read: images of 60 kB at 15 Hz held up transforms for a second.
    """
    for each in _connections(links):
        with suppress(OSError):
            each.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _WITHIN_HOST_BYTES)
            each.setsockopt(socket.IPPROTO_TCP, _LARGEST_WINDOW, _WITHIN_HOST_BYTES)


def admit_datagrams(port: int, hosts: Iterable[str], ending: Iterable[str] = ()) -> str:
    """Let Zenoh's socket that takes datagrams at a port hear these hosts alone, by IPv4, and of
    `ending` hosts the Close of a session; why it does not, "" if it does.

    Zenoh opens all links to a process at once. Were the link of datagrams the first, both would
    tell each other of their declarations by it, and some of them would not arrive.
    """
    program = _only_from(hosts, ending)
    code = ctypes.create_string_buffer(program)
    filter_of = struct.pack("HL", len(program) // _INSTRUCTION.size, ctypes.addressof(code))
    why_not = "its socket was not found"
    for each in _of_type(socket.SOCK_DGRAM):
        with each:
            try:
                if each.getsockname()[1] == port and not _is_connected(each):
                    each.setsockopt(socket.SOL_SOCKET, _ATTACH_FILTER, filter_of)
                    why_not = ""
            except OSError as error:  # such as a filter larger than net.core.optmem_max
                why_not = error.strerror or str(error)
    return why_not


# A program for the kernel, after <linux/filter.h>: a code, two jumps and a number.
_INSTRUCTION = struct.Struct("HBBI")
_LOAD_BYTE, _LOAD_WORD, _AND, _IS_EQUAL, _RETURN = 0x30, 0x20, 0x54, 0x15, 0x06
# From the header of IP on, and behind that of UDP.
_IP, _PAYLOAD = 0x100000000 - 0x100000, 8
_MOST_HOSTS = 1000
_TAKE, _DROP = (_RETURN, 0, 0, 0xFFFF), (_RETURN, 0, 0, 0)
# The kind of Zenoh's messages, in their first byte; the others are flags.
_KIND = 0x1F


def _only_from(hosts: Iterable[str], ending: Iterable[str]) -> bytes:
    """The filter that takes datagrams of these hosts, and of `ending` ones the end of a session."""
    is_close = [(_LOAD_BYTE, 0, 0, _PAYLOAD), (_AND, 0, 0, _KIND)]
    is_close += [(_IS_EQUAL, 0, 1, _CLOSE_SESSION[0] & _KIND), _TAKE, _DROP]
    steps = [(_LOAD_BYTE, 0, 0, _IP), (_AND, 0, 0, 0xF0), (_IS_EQUAL, 1, 0, 0x40), _DROP]
    steps.append((_LOAD_WORD, 0, 0, _IP + 12))
    for of_hosts, then in ((hosts, [_TAKE]), (ending, is_close)):
        for host in sorted(of_hosts)[:_MOST_HOSTS]:
            with suppress(OSError):  # one of IPv6
                number = int.from_bytes(socket.inet_aton(host), "big")
                steps += [(_IS_EQUAL, 0, len(then), number), *then]
    steps.append(_DROP)
    return b"".join(_INSTRUCTION.pack(*step) for step in steps)


def _is_connected(one: socket.socket) -> bool:
    with suppress(OSError):
        return bool(one.getpeername())
    return False


def end_datagrams(links: Container[Ends]) -> None:
    """Have Zenoh close the sessions of links of UDP that this process has opened, at both ends."""
    for each in _of_type(socket.SOCK_DGRAM):
        with each, suppress(OSError):
            if _is_connected(each) and _ends(each) in links:
                _end_session(each)


def _end_session(one: socket.socket) -> None:
    """End the session of Zenoh's connected socket, of which this is a copy: here first, so that
    nothing of it follows the Close that ends it there.
    """
    here, far = one.getsockname(), one.getpeername()
    with socket.socket(one.family, socket.SOCK_DGRAM) as near:
        near.bind((here[0], 0))
        one.connect(near.getsockname())
        near.sendto(_CLOSE_SESSION, here)
    for _ in range(_TIMES):
        with suppress(OSError):  # an answer to a message that Zenoh has sent meanwhile
            one.sendto(_CLOSE_SESSION, far)


class Received(Struct):
    """The bytes that have come by a link: those that were read, and those that wait for it."""

    read: int
    waiting: int


def received_by(links: Container[Ends]) -> dict[Ends, Received]:
    """The bytes that have come by each of these links of TCP that is open. Linux alone can say."""
    import fcntl  # Windows has none of these
    import termios

    found = {}
    for each in _connections(links):
        with suppress(OSError):  # it ends by itself just now
            told = each.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, _RECEIVED.size)
            waits = fcntl.ioctl(each, termios.FIONREAD, bytes(4))
            if len(told) == _RECEIVED.size:
                (waiting,) = struct.unpack("i", waits)
                found[_ends(each)] = Received(_RECEIVED.unpack(told)[0] - waiting, waiting)
    return found


def end_links(links: Container[Ends]) -> None:
    """Break these links: Zenoh takes them for lost, as do the other processes."""
    for each in _connections(links):
        with suppress(OSError):  # it ends by itself just now
            _set_linger(each, 0)
            each.shutdown(socket.SHUT_RDWR)


def _connections(links: Container[Ends]) -> Iterator[socket.socket]:
    for each in _of_type(socket.SOCK_STREAM):
        with each, suppress(OSError):
            if _ends(each) in links:
                yield each


def _of_type(kind: int) -> Iterator[socket.socket]:
    for each in _sockets(_files()):
        if each.type == kind:
            yield each
        else:
            each.close()


def _set_linger(one: socket.socket, seconds: int) -> None:
    one.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, seconds))


def _ends(one: socket.socket) -> Ends:
    here, there = (
        f"{address[0].removeprefix('::ffff:')}:{address[1]}"
        for address in (one.getsockname(), one.getpeername())
    )
    return here, there


def _told_apart(files: set[_OpenFile], marks: SocketMarks) -> ZenohSockets:
    listening, asking, answering = [], [], None
    for each in _sockets(files):
        address, port = each.getsockname()[:2]
        if each.type == socket.SOCK_STREAM:
            if address in marks.listening and _option(
                each, socket.SOL_SOCKET, socket.SO_ACCEPTCONN
            ):
                listening.append(port)
        elif (address, port) == marks.group and answering is None:
            answering = each
            continue
        elif address == "0.0.0.0" and _scouts(each, marks.ttl):
            asking.append(port)
        each.close()
    return ZenohSockets(tuple(listening), tuple(asking), answering)


def _scouts(one: socket.socket, ttl: int) -> bool:
    """Whether a socket is for multicast: on an interface of its own, with this TTL."""
    chosen = _option(one, socket.IPPROTO_IP, socket.IP_MULTICAST_IF)
    return chosen != 0 and _option(one, socket.IPPROTO_IP, socket.IP_MULTICAST_TTL) == ttl


def _option(one: socket.socket, level: int, name: int) -> int:
    with suppress(OSError):
        return one.getsockopt(level, name)
    return 0


def _files() -> set[_OpenFile]:
    found = set()
    for name in os.listdir(_FILES) if os.path.isdir(_FILES) else ():
        with suppress(OSError):  # another thread has closed it
            found.add(_OpenFile(int(name), os.fstat(int(name)).st_ino))
    return found


def _sockets(files: set[_OpenFile]) -> Iterator[socket.socket]:
    """A copy of each socket of IP among the open files."""
    for number, inode in sorted(files):
        with suppress(OSError):  # another thread has closed it
            state = os.fstat(number)
            if stat.S_ISSOCK(state.st_mode) and state.st_ino == inode:
                copy = socket.socket(fileno=os.dup(number))
                if copy.family in (socket.AF_INET, socket.AF_INET6):
                    yield copy
                else:
                    copy.close()
