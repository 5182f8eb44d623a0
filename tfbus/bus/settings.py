"""The settings of one node as one frozen value, and of the networks that robots have."""

import os
import re
import socket
from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from tfbus.base import scheduler
from tfbus.base.errors import RightsError, SettingsError
from tfbus.base.structs import Struct, field, replace
from tfbus.base.wording import printable
from tfbus.wire.descriptions import FLOAT64, POSES
from tfbus.wire.keys import check_namespace, check_node_name, check_parameter, resolve
from tfbus.wire.limits import Limits

if TYPE_CHECKING:
    from tfbus.bus.identity_folder import SecureFolder


# As on the command line and in the environment.
AUTO = "auto"


class Network(Struct):
    """The settings for one kind of network.

    A link that is silent for `lease_s` is lost. A publisher whose link is lost is silent, and
    counts as gone `gone_after_s` later unless it is back. With `has_datagrams`, peers and routers
    have a link of UDP beside each of TCP for dynamic transforms, which are not sent again if they
    are lost. Messages of dynamic transforms, and the packets of links, have at most so many bytes
    (0: without bound); `urgent_batches` packets of transforms wait on a link. A try to open a link
    ends after `open_s`; the next one follows after `retry_s`, twice as much later, and at most
    `longest_s`.
    Between hosts TCP takes further bytes only while fewer than `unsent_bytes` wait in it:
    transforms come after these, and before all that waits in Zenoh. With `tcp_bytes` it has at
    most so many that have not arrived yet, repeats lost packets at a steady pace, and measures
    the bandwidth instead of taking a loss for a full link. With `reads_large`, subscribers ask for
    large messages of topics that do not come.
    """

    name: str
    lease_s: float = 1.5
    gone_after_s: float = 0.0
    has_datagrams: bool = False
    message_bytes: int = 0
    packet_bytes: int = 0
    urgent_batches: int = 8
    open_s: float = 5.0
    retry_s: float = 0.5
    longest_s: float = 1.0
    unsent_bytes: int = 32768
    tcp_bytes: int = 0
    reads_large: bool = False

    @property
    def is_bad(self) -> bool:
        """Whether packets are often lost or late on this network."""
        return bool(self.packet_bytes)


# A packet of a mobile network or a tunnel has 1,420 bytes or more. With the headers of IP, UDP and
# Zenoh and the name of its key, a message of this size goes into one.
_PACKET = 1380
_MESSAGE = 1200

NETWORKS = {
    each.name: each
    for each in (
        Network("lan"),
        Network(
            "wifi",
            lease_s=4.0,
            gone_after_s=3.0,
            has_datagrams=True,
            message_bytes=_MESSAGE,
            packet_bytes=_PACKET,
            urgent_batches=2,
            open_s=1.0,
            retry_s=0.25,
            # Of ten tries at a loss of 5 % one fails: two more are to come before *gone*.
            longest_s=0.5,
            tcp_bytes=24576,
            reads_large=True,
        ),
        Network(
            "mobile",
            lease_s=4.0,
            gone_after_s=4.0,
            message_bytes=_MESSAGE,
            packet_bytes=_PACKET,
            # A send of fifty frames: it finds a place while images fill what TCP holds.
            urgent_batches=6,
            open_s=2.0,
            retry_s=0.25,
            tcp_bytes=16384,
            reads_large=True,
        ),
        Network(
            "satellite",
            lease_s=6.0,
            gone_after_s=6.0,
            has_datagrams=True,
            message_bytes=_MESSAGE,
            packet_bytes=_PACKET,
            urgent_batches=1,
            open_s=2.5,
            retry_s=0.25,
            tcp_bytes=32768,
            reads_large=True,
        ),
    )
}
LAN = NETWORKS["lan"]

NAMES = (*NETWORKS, AUTO)


def check_network(name: str) -> str:
    """The name of a network. Raises SettingsError for any other."""
    if name not in NAMES:
        raise SettingsError(f"network {name!r} is not one of {', '.join(NAMES)}")
    return name


def network_of(name: str, connect: Iterable[str] = ()) -> Network:
    """The network of this name; for `auto` that of the interface by which the first endpoint to
    connect to is reached, or any other host if none is given.

    Wi-Fi and mobile networks are known on Linux. A satellite is not: it is behind a cable.
    """
    if name != AUTO or scheduler.is_simulated:
        return NETWORKS.get(name, LAN)
    interface = _interface_to(next(iter(connect), ""))
    if not interface:
        return LAN
    device = f"{_DEVICES}/{interface}"
    if os.path.isdir(f"{device}/wireless") or os.path.exists(f"{device}/phy80211"):
        return NETWORKS["wifi"]
    if "DEVTYPE=wwan" in _text(f"{device}/uevent") or interface.startswith(("wwan", "ppp")):
        return NETWORKS["mobile"]
    return LAN


_DEVICES = "/sys/class/net"

# Any address that is not here: nothing is sent to it.
_ELSEWHERE = ("192.0.2.1", 9)


def _interface_to(endpoint: str) -> str:
    """The interface that leads to an endpoint, by its address of IPv4; for a name, which may take
    long to resolve, and IPv6 that of the default route. "" if it is not known.
    """
    from tfbus.base.addresses import interfaces  # few processes need these
    from tfbus.bus.links import split_endpoint

    _, host, port = split_endpoint(endpoint)
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.connect((host, port) if port and _is_ipv4(host) else _ELSEWHERE)
            address = probe.getsockname()[0]
    except (OSError, OverflowError):  # no route, or no port that can be
        return ""
    return next((each.name for each in interfaces() if each.address == address), "")


def _is_ipv4(host: str) -> bool:
    try:
        socket.inet_pton(socket.AF_INET, host)
    except (OSError, ValueError):  # a name, also one that cannot be
        return False
    return True


def _text(path: str) -> str:
    try:
        with open(path, encoding="utf-8") as file:
            return file.read()
    except OSError:
        return ""


LOG_LEVELS = ("debug", "info", "warning", "error")
MODES = ("peer", "client", "router")
PROTOCOLS = ("tcp", "udp", "tls", "quic", "ws", "serial", "unixpipe", "unixsock-stream", "vsock")

_LEVELS_OF_ROS = {"warn": "warning", "fatal": "error"}

_TRUE = ("1", "true", "yes", "on")
_FALSE = ("", "0", "false", "no", "off")

# A port, then Zenoh's own additions: tcp/[::]:7447#iface=eth0
_PORT = r":\d{1,5}([?#].*)?$"


def log_level_of(text: str) -> str:
    """The level that a text names, also as ROS writes it: `WARN`, `fatal`."""
    level = str(text).lower()  # a wrong type is no level
    return _LEVELS_OF_ROS.get(level, level)


def _from_environment(name: str) -> str:
    return os.environ.get(f"TFBUS_{name}", "")


def _truth_from_environment(name: str) -> bool:
    text = _from_environment(name).lower()
    if text not in (*_TRUE, *_FALSE):
        raise SettingsError(
            f"TFBUS_{name} must be one of {', '.join(filter(None, (*_TRUE, *_FALSE)))}, "
            f"not {text!r}"
        )
    return text in _TRUE


def _endpoints_from_environment(name: str) -> tuple[str, ...]:
    return tuple(filter(None, _from_environment(name).replace(",", " ").split()))


def _limits_from_environment() -> Limits:
    try:
        return Limits.parse(_from_environment("LIMITS"))
    except SettingsError as error:
        raise SettingsError(f"TFBUS_LIMITS: {error}") from error


class NodeSettings(Struct):
    """A node's name, and how it joins the bus.

    Defaults come from the environment (`TFBUS_NAMESPACE`, `TFBUS_MODE`, `TFBUS_CONNECT`,
    `TFBUS_LISTEN`, `TFBUS_CONFIG`, `TFBUS_SECURE`, `TFBUS_NETWORK`, `TFBUS_LOG_LEVEL`,
    `TFBUS_SIM_TIME`, `TFBUS_LIMITS`, `TFBUS_POSES`). `mode` is "peer", "client", "router", or ""
    for that of the configuration file. Endpoints are Zenoh's (`tcp/host:7447`): several, or one as
    a str. `secure` is the folder of an identity of a closed bus. `network` is "lan", "wifi",
    "mobile", "satellite", or "auto" for that of this host's interface. `limits` are the largest
    messages that it reads and sends; in the environment `topic=64MB, service=8MB`. `poses` is how
    precise the transforms are that it sends: "float64", "float32" or "compact", as of a
    TransformBroadcaster.

    Raises InvalidNameError for an invalid name, SettingsError for any other invalid value.
    """

    name: str
    namespace: str = field(default_factory=lambda: _from_environment("NAMESPACE"))
    mode: str = field(default_factory=lambda: _from_environment("MODE"))
    connect: tuple[str, ...] = field(default_factory=lambda: _endpoints_from_environment("CONNECT"))
    listen: tuple[str, ...] = field(default_factory=lambda: _endpoints_from_environment("LISTEN"))
    config: str = field(default_factory=lambda: _from_environment("CONFIG"))
    secure: str = field(default_factory=lambda: _from_environment("SECURE"))
    network: str = field(default_factory=lambda: _from_environment("NETWORK") or "lan")
    log_level: str = field(default_factory=lambda: _from_environment("LOG_LEVEL") or "info")
    sim_time: bool = field(default_factory=lambda: _truth_from_environment("SIM_TIME"))
    parameters: Mapping[str, Any] = field(default_factory=dict)
    remappings: Mapping[str, str] = field(default_factory=dict)
    limits: Limits = field(default_factory=_limits_from_environment)
    poses: str = field(default_factory=lambda: _from_environment("POSES") or FLOAT64)
    closed: "SecureFolder | None" = field(default=None, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        check_node_name(self.name)
        set_field = object.__setattr__
        set_field(self, "namespace", check_namespace(self.namespace))
        for what in ("parameters", "remappings"):
            set_field(self, what, MappingProxyType(_dict(getattr(self, what), what)))
        for what in ("connect", "listen"):
            set_field(self, what, _endpoints(getattr(self, what), what))
        for name in self.parameters:
            check_parameter(name)
        for name in (*self.remappings, *self.remappings.values()):
            resolve(name, self.name, self.namespace)
        _check_choice("mode", self.mode, ("", *MODES))
        check_network(self.network)
        _check_choice("poses", self.poses, POSES)
        set_field(self, "log_level", log_level_of(self.log_level))
        _check_choice("log level", self.log_level, LOG_LEVELS)
        for endpoint in (*self.connect, *self.listen):
            check_endpoint(endpoint)
        for what, kind in (("config", str), ("sim_time", bool), ("limits", Limits)):
            _check_type(what, getattr(self, what), kind)
        if self.config and not os.path.isfile(self.config):
            raise SettingsError(f"there is no configuration file {self.config!r}")
        if self.secure:
            from tfbus.bus.identity_folder import (
                open_folder,  # YAML, which an open bus does not need
            )

            set_field(self, "secure", os.path.abspath(self.secure))
            set_field(self, "closed", open_folder(self.secure))
            set_field(self, "namespace", self._namespace_within())
            for endpoint in (*self.connect, *self.listen):
                _check_encrypted(endpoint)

    def named_by_default(self, name: str) -> "NodeSettings":
        """These settings for a node whose name the user did not choose.

        On a closed bus if the identity may not run a node of this name, it begins with that of
        the identity: `laptop_echo_5d205229`.
        """
        if self.closed is not None and not self.closed.identity.allows("nodes", name):
            hidden = "_" if name.startswith("_") else ""
            name = f"{hidden}{self.closed.identity.name}_{name.removeprefix('_')}"
        return self.renamed(name)

    def _namespace_within(self) -> str:
        """The namespace, which is the identity's own if none is given."""
        assert self.closed is not None
        identity = self.closed.identity
        if not self.namespace:
            return identity.namespace
        if not identity.is_within(self.namespace):
            raise SettingsError(
                f"identity {identity.name!r} is of the namespace {identity.namespace!r}, not of "
                f"{self.namespace!r}"
            )
        return self.namespace

    def check_right(self, right: str, name: str) -> None:
        """Check a right of a node with these settings for a name as the node uses it.

        `right` is the name of a right of an Identity. Raises RightsError if the bus is closed and
        its identity has not got it.
        """
        if self.closed is None:
            return
        mistake = self.closed.identity.mistake_in(right, name, self.namespace)
        if mistake:
            raise RightsError(mistake)

    @property
    def full_name(self) -> str:
        """The node's name with its namespace: `/sim`, `/robot7/sim`."""
        return "/" + "/".join(filter(None, (self.namespace, self.name)))

    def renamed(self, name: str) -> "NodeSettings":
        """These settings for a node of another name."""
        return replace(self, name=name)


def _dict(values: Any, what: str) -> dict[str, Any]:
    try:
        return dict(values)
    except (TypeError, ValueError):
        raise SettingsError(
            f"{what} must be a dict, with a value for each name, not {type(values).__name__}"
        ) from None


def _endpoints(endpoints: object, what: str) -> tuple[str, ...]:
    """Several endpoints, or the one of a str."""
    several = (endpoints,) if isinstance(endpoints, str) else endpoints
    if not isinstance(several, Iterable):
        raise SettingsError(
            f"{what} must be an endpoint such as tcp/host:7447, or a list of them, not "
            f"{type(several).__name__}"
        )
    found = tuple(several)
    for endpoint in found:
        if not isinstance(endpoint, str):
            raise SettingsError(
                f"{what}: each endpoint must be a str such as tcp/host:7447, not "
                f"{type(endpoint).__name__}"
            )
    return found


def check_endpoint(endpoint: str) -> None:
    """Raise SettingsError unless the text is an endpoint of Zenoh's, as tcp/host:7447."""
    if not endpoint.isprintable():
        shown = printable(endpoint, 60)
        raise SettingsError(f"endpoint '{shown}' has a character that cannot be printed")
    protocol, found, address = endpoint.partition("/")
    if not found:
        written = endpoint if ":" in endpoint else f"{endpoint}:7447"
        raise SettingsError(
            f"{endpoint!r} is not an endpoint: write protocol/address, as in tcp/{written}"
        )
    if protocol not in PROTOCOLS:
        raise SettingsError(
            f"endpoint {endpoint!r} has an unknown protocol: use one of {', '.join(PROTOCOLS)}"
        )
    if protocol in ("tcp", "udp", "tls") and not re.search(_PORT, address):
        raise SettingsError(f"endpoint {endpoint!r} has no port: write {protocol}/{address}:7447")


def _check_encrypted(endpoint: str) -> None:
    protocol, _, address = endpoint.partition("/")
    if protocol != "tls":
        raise SettingsError(
            f"endpoint {endpoint!r} is not encrypted, and --secure has only links that are: write "
            f"tls/{address}"
        )


def _check_type(what: str, value: object, kind: type) -> None:
    if not isinstance(value, kind):
        hint = "; Limits.parse reads a text" if kind is Limits and isinstance(value, str) else ""
        raise SettingsError(f"{what} must be a {kind.__name__}, not {value!r:.60}{hint}")


def _check_choice(what: str, value: str, allowed: tuple[str, ...]) -> None:
    if value not in allowed:
        choices = ", ".join(filter(None, allowed))
        raise SettingsError(f"{what} {value!r} is not one of {choices}")
