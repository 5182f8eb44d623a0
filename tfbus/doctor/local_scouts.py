"""The processes of this host that take part in Zenoh's scouting, by the sockets they have open."""

import os
from contextlib import suppress
from pathlib import Path

# 224.0.0.224:7446, as Linux writes it.
_GROUP = "E00000E0:1D16"

_SOCKETS = Path("/proc/net/udp")


def local_scouts() -> dict[int, str]:
    """The names of other processes by their pids; {} if the host is not Linux.

    Only processes of the same user show their sockets, or all to root.
    """
    sockets = _scouting_sockets()
    found = {}
    for process in Path("/proc").glob("[0-9]*") if sockets else ():
        if process.name != str(os.getpid()) and _has_one(process, sockets):
            with suppress(OSError):
                found[int(process.name)] = (process / "comm").read_text().strip()
    return found


def _scouting_sockets() -> set[str]:
    try:
        rows = [line.split() for line in _SOCKETS.read_text().splitlines()[1:]]
    except OSError:
        return set()
    return {f"socket:[{row[9]}]" for row in rows if len(row) > 9 and row[1] == _GROUP}


def _has_one(process: Path, sockets: set[str]) -> bool:
    try:
        for file in (process / "fd").iterdir():
            with suppress(OSError):
                if os.readlink(file) in sockets:
                    return True
    except OSError:  # it is another user's, or has ended
        pass
    return False
