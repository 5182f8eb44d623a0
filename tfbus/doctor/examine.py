"""Gathers all that the checks need from a live bus: its transforms and nodes, this host, and ROS
around it.

DDS announces itself by RTPS, multicast, as ROS 2 on most middlewares does: the messages are as in
https://www.omg.org/spec/DDSI-RTPS/2.5, sections 8.5.3 and 9.6.2.
"""

import errno
import logging
import math
import os
import platform
import socket
import struct
import sys
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Generator, Iterable, Sequence
from contextlib import suppress
from dataclasses import replace
from importlib import metadata
from pathlib import Path
from typing import Any

from tfbus.base import scheduler
from tfbus.base.addresses import interfaces
from tfbus.base.clock import SYSTEM_CLOCK
from tfbus.base.errors import BusError, DecodeError, SettingsError
from tfbus.base.installation import version_and_origin, why_interpreted
from tfbus.buffer.buffer import COMPILED, Buffer
from tfbus.bus.links import why_unreachable
from tfbus.bus.neighbours import scout
from tfbus.bus.presence import Described, bus_out_of_reach
from tfbus.bus.session import Session
from tfbus.bus.settings import NodeSettings
from tfbus.bus.zenoh_config import has_scouting, listens_beyond_loopback, zenoh_config
from tfbus.doctor.examination import Examination, ExaminedHost, Participant, RosAround
from tfbus.frames.command_listener import Listening, ask_others, wait_for_clock
from tfbus.frames.fleet import FleetWatch
from tfbus.frames.meter import TransformMeter
from tfbus.node.node import Node
from tfbus.ros.rmw import domain_of, is_domain
from tfbus.ros.ros1 import Ros1Master
from tfbus.streams.listener import TransformListener
from tfbus.wire.fleet import Fleet

# The transforms that publishers keep show the rates before.
_HISTORY_S = 10.0


def examine(
    settings: NodeSettings,
    listen_s: float,
    on_unreadable: Callable[[DecodeError], object],
    fleet: Fleet | None = None,
    roster: Sequence[str] = (),
    grace_s: float = 0.0,
) -> Generator[Examination]:
    """Look at this host and, for `listen_s` seconds, at the transforms of its namespace or fleet;
    then for as long again, and so on, if a further examination is asked for: it counts from where
    the one before has ended. `roster` are the robots of the fleet that are expected, () for any;
    in the first `grace_s` seconds they may be booting. After a pause of this process it listens on.

    Raises BusError if the bus cannot be joined, TimeoutException if simulated time is used and no
    clock runs.
    """
    quiet = replace(settings, log_level="error")
    with RosWatch(settings) as ros, Node(settings=quiet, patience_s=0.0) as node:
        wait_for_clock(node)
        node.session.settle()
        # Before we subscribe: a listener that nodes report is not ours.
        answers = _ask(node.session, on_unreadable)
        out_of_reach = "" if answers.nodes else bus_out_of_reach(node.session)
        host = examine_host(settings, node.session)
        buffer, before = Buffer(_HISTORY_S), None
        grace_ends_s = scheduler.monotonic() + grace_s
        watch = None if fleet is None else FleetWatch(roster)
        with TransformListener(buffer, node, history_s=_HISTORY_S, fleet=fleet) as listener:
            heard = Listening(node, buffer, listener, fleet)
            while True:
                # Rates are compared with the rates by the stamps.
                meter = TransformMeter(node, fleet, recent_s=math.inf, clock=node.clock)
                began_s = scheduler.monotonic()
                _listen(node, listen_s)
                heard.catch_up()
                listened_s = scheduler.monotonic() - began_s
                if before is not None:
                    # A process that begins or ends meanwhile is missing on one of the two sides.
                    scouts = local_scouts()
                    answers = _ask(node.session, on_unreadable)
                    host = replace(host, **_scouts(scouts.items() & local_scouts().items()))
                heard.set_answers(answers)
                now = heard.moment()
                yield Examination(
                    settings,
                    now if before is None else now.since(before),
                    tuple(meter.edges()),
                    meter.streams(),
                    listened_s,
                    host,
                    ros.around(node.session),
                    "" if now.nodes else out_of_reach,
                    is_fleet=watch is not None,
                    robots=tuple(watch.robots(now, has_frames=False)) if watch else (),
                    roster=tuple(roster),
                    is_booting=scheduler.monotonic() < grace_ends_s,
                )
                meter.close()
                before = now
    raise KeyboardInterrupt  # the node's `with` swallowed it


def _ask(session: Session, on_unreadable: Callable[[DecodeError], object]) -> Described:
    answers = ask_others(session)
    for error in answers.unreadable:
        on_unreadable(error)
    return answers


def _listen(node: Node, listen_s: float) -> None:
    if not node.wait(listen_s, clock=SYSTEM_CLOCK):
        raise KeyboardInterrupt


_PACKAGES = ("eclipse-zenoh", "numpy", "msgpack", "click", "PyYAML")
_SCOUT_S = 1.5


def examine_host(settings: NodeSettings, session: Session) -> ExaminedHost:
    """Look at this host and its session; the trial of scouting takes 1 to 2 s."""
    return ExaminedHost(
        versions={
            "Python": platform.python_version(),
            "tfbus": version_and_origin(),
            **{name: _version(name) for name in _PACKAGES},
        },
        is_compiled=COMPILED,
        why_interpreted="" if COMPILED else why_interpreted(),
        interfaces=tuple(interfaces()),
        scouted=_is_scouted(settings),
        routers=len(session.routers()),
        without_datagrams=session.without_datagrams,
        unreachable={
            endpoint: why for endpoint in settings.connect if (why := why_unreachable(endpoint))
        },
        **_scouts(local_scouts().items()),
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
    alone = replace(settings, connect=(), mode="peer")
    # The doctor's own node has the id of the configuration, and the ports.
    with Session(alone, log, scouting_s=0.01, is_second=True) as session:
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


def _scouts(processes: Iterable[tuple[int, str]]) -> dict[str, Any]:
    """The fields of an ExaminedHost that say which processes scout."""
    scouts = dict(processes)
    return {"scouts": scouts, "stopped": frozenset(filter(is_stopped, scouts))}


def is_stopped(pid: int) -> bool:
    """Whether a process does not run, since SIGSTOP or a debugger has stopped it."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_text()
    except OSError:  # it has ended
        return False
    return stat.rpartition(") ")[2][:1] in ("T", "t")


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


_RTPS_GROUP = "239.255.0.1"
_FIRST_PORT, _PORTS_OF_A_DOMAIN = 7400, 250

# A header: its kind, its version, its vendor, and its participant.
_MAGIC = b"RTPS"
_VENDOR = slice(6, 8)
_PARTICIPANT = slice(8, 20)
_HEADER_SIZE = 20
# The writer of the announcements of participants; and ROS 2's mark in them.
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
        self.is_port_taken = is_taken(port)
        try:
            self._socket = joined_socket(port)
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
                    self._add_participant(self._socket.recv(_LARGEST))

    def _add_participant(self, packet: bytes) -> None:
        participant = participant_of(packet)
        if participant is not None and len(self._found) < _MOST:
            self._found[participant.id] = participant


def is_taken(port: int) -> bool:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(("", port))
        except OSError as error:
            return error.errno == errno.EADDRINUSE
    return False


def joined_socket(port: int) -> socket.socket:
    """A socket that hears the group on every interface, beside the others of this host."""
    made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if hasattr(socket, "SO_REUSEPORT"):
            with suppress(OSError):
                made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
        # At the group's own address it takes no message from a participant of this host. Windows
        # has no such sockets.
        made.bind(("" if sys.platform == "win32" else _RTPS_GROUP, port))
        made.settimeout(_WAIT_S)
        for index, _ in socket.if_nameindex():
            _join(made, index)
    except OSError:
        made.close()
        raise
    return made


def _join(made: socket.socket, interface: int) -> None:
    group = struct.pack("=4s4si", socket.inet_aton(_RTPS_GROUP), bytes(4), interface)
    with suppress(OSError):  # one that is down, or carries no multicast
        made.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, group)


# The tokens of rmw_zenoh, and of zenoh-bridge-ros2dds.
_TOKENS = "/@ros2_lv/**"
_TOKENS_OF_BRIDGES = "/@/*/@ros2_lv/**"

# Where rmw_zenoh has its router, and `tfbus ros2 --via zenoh` looks for it.
ROS_ROUTER = ("localhost", 7447)

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
        # A thread within Zenoh at Python's end would abort the process, so `close` waits for it.
        self._at_router = threading.Thread(target=self.look_at_router, name="ros router")
        self._at_master = threading.Thread(target=self._look_at_master, name="ros", daemon=True)
        for thread in (self._at_router, self._at_master):
            thread.start()

    def __enter__(self) -> "RosWatch":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End it. Twice is fine."""
        if self._rtps is not None:
            self._rtps.close()
        self._at_router.join()

    def around(self, session: Session) -> RosAround:
        """The findings so far; `session` is the bus's."""
        for thread in (self._at_router, self._at_master):
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

    def look_at_router(self) -> None:
        """The tokens at rmw_zenoh's router, which this bus need not be connected to."""
        with suppress(OSError):
            socket.create_connection(ROS_ROUTER, _ANSWER_WITHIN_S).close()
            settings = NodeSettings(
                self._settings.name,
                namespace="",
                mode="client",
                connect=("tcp/{}:{}".format(*ROS_ROUTER),),
                listen=(),
                config="",
                secure="",
                network="wifi",  # a stranger that does not answer is given up after 1 s
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
        return len(Ros1Master(uri, "/tfbus_doctor", _ANSWER_WITHIN_S).state().nodes)
    except OSError:
        return None
