"""How the processes of one machine find each other where the machine has no network."""

import socket
import struct
import sys

# Of Linux's <linux/sockios.h> and <net/if.h>.
_GET_FLAGS = 0x8913
_UP = 0x1
_LOOPBACK = 0x8
_MULTICAST = 0x1000


def loopback_where_alone() -> str:
    """The loopback interface where no other can carry multicast, "" otherwise.

    Zenoh scouts on every interface but loopback, so that without a network it finds nobody, not
    even on the same machine. Known on Linux only; "" elsewhere.
    """
    loopback = ""
    for _, name in socket.if_nameindex() if sys.platform == "linux" else ():
        flags = _flags(name)
        if flags & _LOOPBACK:
            loopback = name
        elif flags & _UP and flags & _MULTICAST:
            return ""
    return loopback


def _flags(interface: str) -> int:
    import fcntl  # not there on Windows

    request = struct.pack("16sh14x", interface.encode(), 0)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        answer = fcntl.ioctl(any_socket, _GET_FLAGS, request)
    flags: int = struct.unpack("16sh14x", answer)[1]
    return flags
