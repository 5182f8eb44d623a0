"""Looks for ROS around this host, by each way that it may be reached."""

import logging
import os
import socket
import threading
from collections import defaultdict
from collections.abc import Iterable
from contextlib import suppress

from tfbus.bus.session import Session
from tfbus.bus.settings import NodeSettings
from tfbus.doctor.examination import RosAround
from tfbus.doctor.rtps import RtpsWatch
from tfbus.errors import BusError, SettingsError
from tfbus.ros.ros1 import Ros1Master
from tfbus.ros.ros_names import domain_of, is_domain

# The tokens of rmw_zenoh, and those of zenoh-bridge-ros2dds.
_TOKENS = "/@ros2_lv/**"
_TOKENS_OF_BRIDGES = "/@/*/@ros2_lv/**"

# Where rmw_zenoh has its router, and `tfbus ros2 --via zenoh` looks for it.
_ROUTER_HOST, _ROUTER_PORT = "localhost", 7447
_ROUTER = f"tcp/{_ROUTER_HOST}:{_ROUTER_PORT}"

_ANSWER_WITHIN_S = 1.0
# A router or master that does not answer is not waited for any longer.
_LATER_S = 1.0


class RosWatch:
    """Looks for ROS from now on, in the background, until `close()`."""

    def __init__(self, settings: NodeSettings) -> None:
        self._settings = settings
        self._domain = _domain()
        self._rtps = None if self._domain < 0 else RtpsWatch(self._domain)
        self._tokens: list[str] = []
        self._master = os.environ.get("ROS_MASTER_URI", "")
        self._master_nodes: int | None = None
        self._threads = [
            threading.Thread(target=look, name="ros", daemon=True)
            for look in (self._look_at_router, self._look_at_master)
        ]
        for thread in self._threads:
            thread.start()

    def __enter__(self) -> "RosWatch":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End it. Twice is fine."""
        if self._rtps is not None:
            self._rtps.close()

    def around(self, session: Session) -> RosAround:
        """The findings so far; `session` is that of the bus."""
        for thread in self._threads:
            thread.join(_LATER_S)
        on_bus = [] if self._settings.closed else _tokens_of(session)
        nodes, bridges = read_tokens([*on_bus, *self._tokens])
        connect = self._settings.connect
        rtps = self._rtps
        return RosAround(
            nodes,
            connect[0] if connect and not self._tokens else "",
            bridges,
            self._domain,
            () if rtps is None else rtps.participants(),
            rtps is not None and rtps.is_port_taken,
            0.0 if rtps is None else rtps.listened_s,
            os.environ.get("ROS_DISTRO", ""),
            os.environ.get("ROS_VERSION") == "1",
            self._master,
            self._master_nodes,
        )

    def _look_at_router(self) -> None:
        """The tokens at rmw_zenoh's router, which this bus need not be connected to."""
        with suppress(OSError):
            socket.create_connection((_ROUTER_HOST, _ROUTER_PORT), _ANSWER_WITHIN_S).close()
            settings = NodeSettings(
                self._settings.name,
                namespace="",
                mode="client",
                connect=(_ROUTER,),
                listen=(),
                config="",
                secure="",
            )
            log = logging.getLogger(__name__)
            with suppress(BusError), Session(settings, log, is_second=True) as session:
                self._tokens = _tokens_of(session)

    def _look_at_master(self) -> None:
        if self._master:
            self._master_nodes = nodes_of_master(self._master)


def read_tokens(tokens: Iterable[str]) -> tuple[dict[int, frozenset[str]], int]:
    """The nodes of rmw_zenoh by domain, and the number of bridges, by the keys of their tokens."""
    nodes: dict[int, set[str]] = defaultdict(set)
    bridges: set[str] = set()
    for token in tokens:
        match token.split("/"):
            case ["@", bridge, *_]:
                bridges.add(bridge)
            case [_, domain, _, _, _, "NN", _, namespace, name, *_] if is_domain(domain):
                nodes[int(domain)].add(f"{namespace.replace('%', '/').rstrip('/')}/{name}")
            case [_, bridge, *_] if not is_domain(bridge):
                # As zenoh-bridge-ros2dds had them before 1.0.
                bridges.add(bridge)
    return {domain: frozenset(names) for domain, names in nodes.items()}, len(bridges)


def _tokens_of(session: Session) -> list[str]:
    return [*session.living(_TOKENS), *session.living(_TOKENS_OF_BRIDGES)]


def _domain() -> int:
    """The domain of ROS 2 that its programs would use here; -1 if they would fail."""
    try:
        return domain_of()
    except SettingsError:
        return -1


def nodes_of_master(uri: str) -> int | None:
    """The number of nodes that a master of ROS 1 knows; None if it does not answer."""
    try:
        state = Ros1Master(uri, "/tfbus_doctor", _ANSWER_WITHIN_S).state()
    except OSError:
        return None
    return len({node for kind in state for nodes in kind.values() for node in nodes})
