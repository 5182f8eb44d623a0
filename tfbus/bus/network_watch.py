"""Waits until the network of this host changes: its interfaces, their carriers, their addresses."""

import socket
import sys
from typing import Any

# From Linux's <linux/rtnetlink.h>: changes of links and of addresses of IPv4.
_LINKS = 0x1
_ADDRESSES = 0x10

_MOST_BYTES = 65536

# The interfaces are looked at after this time if the kernel does not tell of changes.
_POLLED_S = 2.0


class NetworkWatch:
    """Becomes readable when the network of this host may have changed, until `close()`.

    The kernel tells of changes by a socket. If it does not, as in some containers, `socket` is None
    and `polled_s` the time after which to look; None if nothing needs a look.
    """

    def __init__(self) -> None:
        self.socket = _told_by_kernel()
        self.polled_s = None if self.socket is not None else _POLLED_S

    def drain(self) -> None:
        """Forget what the kernel has told."""
        if self.socket is not None:
            try:
                while self.socket.recv(_MOST_BYTES):
                    pass
            except OSError:  # nothing is left, or more came than the kernel keeps
                pass

    def close(self) -> None:
        """End the watch. Twice is fine."""
        if self.socket is not None:
            self.socket.close()


def _told_by_kernel() -> Any:
    if sys.platform != "linux":
        return None
    told = None
    try:
        told = socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, socket.NETLINK_ROUTE)
        told.bind((0, _LINKS | _ADDRESSES))
    except OSError:
        if told is not None:
            told.close()
        return None
    told.setblocking(False)
    return told
