"""Looks at this host: its packages, its interfaces, whether scouting works, and who scouts."""

import logging
import os
import platform
import socket
from contextlib import suppress
from dataclasses import replace
from importlib import metadata
from pathlib import Path

from tfbus.buffer.buffer import COMPILED
from tfbus.bus.endpoints import why_unreachable
from tfbus.bus.interfaces import interfaces
from tfbus.bus.scout import scout
from tfbus.bus.session import Session
from tfbus.bus.settings import NodeSettings
from tfbus.bus.zenoh_config import has_scouting, listens_beyond_loopback, zenoh_config
from tfbus.doctor.examination import Host
from tfbus.runtime.installation import version_and_origin, why_interpreted

_PACKAGES = ("eclipse-zenoh", "numpy", "msgpack", "click", "PyYAML")
_SCOUT_S = 1.5


def examine_host(settings: NodeSettings, routers: int) -> Host:
    """Look at this host; the trial of scouting takes 1 to 2 s."""
    return Host(
        versions={
            "Python": platform.python_version(),
            "tfbus": version_and_origin(),
            **{name: _version(name) for name in _PACKAGES},
        },
        is_compiled=COMPILED,
        why_interpreted="" if COMPILED else why_interpreted(),
        interfaces=tuple(interfaces()),
        scouted=_is_scouted(settings),
        routers=routers,
        unreachable={
            endpoint: why for endpoint in settings.connect if (why := why_unreachable(endpoint))
        },
        scouts=local_scouts(),
        name=socket.gethostname(),
        listens_beyond=listens_beyond_loopback(zenoh_config(settings)),
    )


def _version(package: str) -> str:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return ""


def _is_scouted(settings: NodeSettings) -> bool | None:
    """Whether scouting finds a session of ours; None if scouting is off."""
    if not has_scouting(settings):
        return None
    log = logging.getLogger(__name__)
    with Session(replace(settings, connect=(), mode="peer"), log, scouting_s=0.01) as session:
        own = session.id
        return own in scout(settings, _SCOUT_S, until=lambda zid, _: zid == own)


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
