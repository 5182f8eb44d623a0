"""Looks at this host: its packages, its interfaces, and whether scouting works."""

import logging
import platform
import socket
from dataclasses import replace
from importlib import metadata

from tfbus.buffer.buffer import COMPILED
from tfbus.bus.endpoints import why_unreachable
from tfbus.bus.interfaces import interfaces
from tfbus.bus.scout import scout
from tfbus.bus.session import Session
from tfbus.bus.settings import NodeSettings
from tfbus.bus.zenoh_config import has_scouting, listens_beyond_loopback, zenoh_config
from tfbus.doctor.examination import Host
from tfbus.doctor.local_scouts import local_scouts
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
