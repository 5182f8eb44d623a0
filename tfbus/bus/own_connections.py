"""The TCP connections of this process, which it can shut whichever library holds them."""

import os
import socket
from contextlib import suppress
from pathlib import Path

# An IP address and a port.
Address = tuple[str, int]

# What this process has open, as Linux tells it.
_OPEN = Path("/proc/self/fd")


def can_shut() -> bool:
    """Whether connections can be found here: on Linux only."""
    return _OPEN.is_dir()


def shut(port: int, remote: Address) -> None:
    """Shut the connection from a port of this process to a remote address, if there is one.

    Whoever uses it learns of it as if the other side had closed. Raises FileNotFoundError where
    it is not Linux.
    """
    for entry in filter(Path.is_socket, _OPEN.iterdir()):
        # Others, or ones of other families, have no such addresses.
        with (
            suppress(OSError, IndexError, ValueError),
            socket.socket(fileno=os.dup(int(entry.name))) as connection,
        ):
            own = plain(connection.getsockname())
            if own[1] == port and plain(connection.getpeername()) == remote:
                connection.shutdown(socket.SHUT_RDWR)


def plain(address: tuple[object, ...]) -> Address:
    """The address of a socket; IPv4 ones are told as IPv6 where the socket is for both."""
    return str(address[0]).removeprefix("::ffff:"), int(str(address[1]))
