"""Hears DDS announce itself, as ROS 2 on most middlewares does: RTPS by multicast.

The messages are those of https://www.omg.org/spec/DDSI-RTPS/2.5, sections 8.5.3 and 9.6.2.
"""

import errno
import socket
import struct
import sys
import threading
import time
from contextlib import suppress

from tfbus.doctor.examination import Participant

_GROUP = "239.255.0.1"
_FIRST_PORT, _PORTS_OF_A_DOMAIN = 7400, 250

# A header: what it is, its version, its vendor, and which participant it is from.
_MAGIC = b"RTPS"
_VENDOR = slice(6, 8)
_PARTICIPANT = slice(8, 20)
_HEADER_SIZE = 20
# What writes the announcements of participants; and what ROS 2 says of itself in them.
_ANNOUNCER = b"\x00\x01\x00\xc2"
_OF_ROS = b"enclave="

_VENDORS = {
    b"\x01\x01": "Connext",
    b"\x01\x02": "OpenSplice",
    b"\x01\x03": "OpenDDS",
    b"\x01\x0f": "Fast DDS",
    b"\x01\x10": "Cyclone DDS",
    b"\x01\x11": "GurumDDS",
    b"\x01\x12": "RustDDS",
}

_LARGEST = 65_536
_MOST = 1000
_WAIT_S = 0.1


def participant_of(packet: bytes) -> Participant | None:
    """The participant that announces itself in a packet; None if it is no announcement."""
    if len(packet) < _HEADER_SIZE or packet[:4] != _MAGIC or _ANNOUNCER not in packet:
        return None
    vendor = _VENDORS.get(packet[_VENDOR], "DDS")
    return Participant(packet[_PARTICIPANT], vendor, _OF_ROS in packet)


class RtpsWatch:
    """Hears the participants of a domain from now on, until `close()`; needs no privileges.

    Some announce themselves every 3 s, others every 30 s. Processes of this host have taken the
    port:
    `is_port_taken`.
    """

    def __init__(self, domain: int) -> None:
        self._began_s = time.monotonic()
        self._ends = threading.Event()
        self._found: dict[bytes, Participant] = {}
        port = _FIRST_PORT + _PORTS_OF_A_DOMAIN * domain
        self.is_port_taken = _is_taken(port)
        try:
            self._socket = _joined(port)
        except OSError:  # as on a host without a network: nothing is heard
            self._thread = None
            return
        self._thread = threading.Thread(target=self._run, name="rtps", daemon=True)
        self._thread.start()

    @property
    def listened_s(self) -> float:
        """How long it has listened so far; 0 if it cannot."""
        return time.monotonic() - self._began_s if self._thread else 0.0

    def participants(self) -> tuple[Participant, ...]:
        """The participants heard so far."""
        return tuple(self._found.copy().values())

    def close(self) -> None:
        """Hear nothing further. Twice is fine."""
        self._ends.set()
        if self._thread is not None:
            self._thread.join()

    def _run(self) -> None:
        with self._socket:
            while not self._ends.is_set():
                with suppress(OSError):
                    self._take(self._socket.recv(_LARGEST))

    def _take(self, packet: bytes) -> None:
        participant = participant_of(packet)
        if participant is not None and len(self._found) < _MOST:
            self._found[participant.id] = participant


def _is_taken(port: int) -> bool:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(("", port))
        except OSError as error:
            return error.errno == errno.EADDRINUSE
    return False


def _joined(port: int) -> socket.socket:
    """A socket that hears the group on every interface, beside the others of this host."""
    made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if hasattr(socket, "SO_REUSEPORT"):
            with suppress(OSError):
                made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
        # At the group's own address it takes no message from a participant of this host. Windows
        # has no such sockets.
        made.bind(("" if sys.platform == "win32" else _GROUP, port))
        made.settimeout(_WAIT_S)
        for index, _ in socket.if_nameindex():
            _join(made, index)
    except OSError:
        made.close()
        raise
    return made


def _join(made: socket.socket, interface: int) -> None:
    group = struct.pack("=4s4si", socket.inet_aton(_GROUP), bytes(4), interface)
    with suppress(OSError):  # one that is down, or carries no multicast
        made.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, group)
