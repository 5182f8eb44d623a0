"""Zenoh's configuration: the node's settings over its configuration file over our defaults."""

import json
import os
import re
from collections.abc import Iterable
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import zenoh

from tfbus.base.addresses import is_local, scouted
from tfbus.base.errors import SettingsError
from tfbus.bus.links import split_endpoint
from tfbus.bus.scouting import Scouting
from tfbus.bus.settings import PROTOCOLS, Network, NodeSettings, network_of
from tfbus.bus.zenoh_library import first_sentence
from tfbus.wire.limits import size_text

if TYPE_CHECKING:
    from tfbus.bus.identity_folder import SecureFolder

# Zenoh sends so many keep-alives in a lease; on links that lose packets twice as many, since four
# in a row may be lost.
_KEEP_ALIVES = 4

# At the end of an endpoint of datagrams beside another one.
_DATAGRAMS = "?rel=0"

# A try to open a link of datagrams that fails half leaves the other end with a link until its lease
# is over: of each process so many are taken, beside that of TCP.
_MOST_LINKS = 4

# Of two peers that another introduces, one connects. By Zenoh's own "always" both do, and have two
# links: after a host was unplugged one of them stayed, with the tokens of the absent peer, and such
# a link may stay in half (eclipse-zenoh/zenoh#2806). The price: a peer that can connect and cannot
# be connected to meets only peers with smaller ids.
_ONE_CONNECTS = {"peer": {"to_router": "always", "to_peer": "greater-zid"}}


# What connects to a client that listens: it passes on what they send, and asks its router for what
# they want. Of all else that there is it knows nothing, as a router would.
_BELOW_A_CLIENT = {"south": [{"filters": [{"modes": ["client", "peer"]}]}]}

# Zenoh drops larger messages without a word. So that a message somewhat too large is still named in
# the log, it passes on up to this many times the largest limit, and 64 KiB for the bytes around it.
_NAMED_UP_TO = 2
_AROUND_A_PAYLOAD = 65536
_MOST_OF_ZENOH = 2**32 - 1

# From this number on, rules of access control are read faster from a file.
_MANY_RULES = 300

# A pool of Zenoh's own size of 16 publishers of this host; each reader locks all of it.
_LOCKED_AT_LEAST = 256_000_000

# A process that is to have no datagrams takes none either that a router offers to all scouts: Zenoh
# tries the offered protocols in any order, and a connection must not begin by datagrams.
_LINK_PROTOCOLS = "transport/link/protocols"

# On a bad network so many packets of topics wait on a link. With Zenoh's two, of ten topics at
# 50 Hz a fifth was lost.
_TOPIC_BATCHES = 16

_INTERFACE = "scouting/multicast/interface"
_DEFAULT_GROUP = "224.0.0.224:7446"
_GROUP = re.compile(r"(\d+\.\d+\.\d+\.\d+):(\d+)")

# The port at the end of each endpoint in a list in JSON: ["tcp/[::]:7447#iface=eth0"].
_PORT = re.compile(r':\d{1,5}(?=["?#])')


def zenoh_config(
    settings: NodeSettings,
    scouting_s: float | None = None,
    network: Network | None = None,
    *,
    is_second: bool = False,
) -> zenoh.Config:
    """Zenoh's configuration for these settings: the file's, overridden by the given values.

    A session opens without others after `scouting_s` seconds of scouting (None: as configured). The
    second one of a process has another id, and listens as the first does, on ports that are free.
    `network` is the one that a session has found by the settings, None to find it.
    Raises SettingsError if the file is not a configuration.
    """
    config = _config_of(settings.config)
    named = _named_in_file(settings.config)
    network = network or network_of(settings.network, settings.connect)
    defaults = {
        # Late joiners order retained messages by their time.
        "timestamping/enabled": True,
        # Zenoh looks at the interfaces once in a process.
        _INTERFACE: ",".join(each.address for each in scouted()),
        "scouting/gossip/autoconnect_strategy": _ONE_CONNECTS,
        # An unplugged host is noticed after this time; Zenoh's default is 10 s.
        "transport/link/tx/lease": round(network.lease_s * 1e3),
        # On a LAN at most 1 s passes between two tries to reach an endpoint, and a try ends after
        # 5 s: TCP itself would send its third question after 7 s. By default 4 s and 10 s.
        "connect/retry": _retry(network),
        "transport/unicast/open_timeout": round(network.open_s * 1e3),
        # With Zenoh's two, a burst of 10,000 transforms on as many keys lost up to 2,000 of them.
        "transport/link/tx/queue/size/interactive_high": network.urgent_batches,
        # Zenoh's default is 1 GB, and any peer could make every process hold that.
        "transport/link/rx/max_message_size": min(
            _NAMED_UP_TO * settings.limits.largest + _AROUND_A_PAYLOAD, _MOST_OF_ZENOH
        ),
        # A process that may lock too little memory loses, without a word, each message that another
        # puts into it; and Zenoh polls it 30 times a second, which doubles the CPU when idle.
        "transport/shared_memory": {"enabled": False},
    }
    if settings.mode == "client" and settings.listen:
        defaults["gateway"] = _BELOW_A_CLIENT
    if network.is_bad:
        defaults |= _of_bad_network(network)
    has_datagrams = network.has_datagrams and settings.closed is None
    if has_datagrams:
        defaults["transport/unicast/max_links"] = _MOST_LINKS
    given: dict[str, Any] = {
        "namespace": settings.namespace,
        "mode": settings.mode,
        "connect/endpoints": list(settings.connect),
        "listen/endpoints": list(settings.listen),
    }
    is_client = (settings.mode or _mode(config)) == "client"
    is_within_host = (
        is_client
        and not (settings.listen or _is_in(named, "listen/endpoints"))
        and all(map(_is_of_loopback, settings.connect or ("",)))
    )
    window = None if is_within_host else network.tcp_bytes or None
    if has_datagrams and not is_client:
        for key in ("connect/endpoints", "listen/endpoints"):
            given[key] = _with_datagrams(given[key])
    else:
        # Linux adds to the last packet that waits, beyond SO_SNDBUF, until it has half of the
        # window of the other end: by default 64 kB, for which 1 Mbit/s takes 0.5 s.
        defaults["transport/link/tcp/so_rcvbuf"] = window
    if settings.closed is not None:
        # A client that listens has clients of its own, as the router of a site has.
        carried = is_client and not settings.listen
        given |= _encrypted(settings.closed, window, carried=carried)
        if not settings.listen and settings.mode != "client":
            given["listen/endpoints"] = ["tls/[::]:0"]
    if scouting_s is not None:
        given["scouting/delay"] = given["scouting/timeout"] = round(scouting_s * 1e3)
    unnamed = {key: value for key, value in defaults.items() if not _is_in(named, key)}
    control = given.pop("access_control", None)
    for key, value in {**unnamed, **given}.items():
        if value:
            config.insert_json5(key, json.dumps(value))
    if control:
        config = _with_access_control(config, control)
    is_open = settings.closed is None
    if is_open and not _is_in(named, _LINK_PROTOCOLS) and not _has_udp(config):
        others = [each for each in PROTOCOLS if each != "udp"]
        config.insert_json5(_LINK_PROTOCOLS, json.dumps(others))
    if is_second:
        # Not the id that a file gives to the first; without a leading zero, as Zenoh wants it.
        config.insert_json5("id", json.dumps(f"a{os.urandom(15).hex()}"))
        listen = config.get_json("listen/endpoints")
        config.insert_json5("listen/endpoints", _PORT.sub(":0", listen))
    return config


def end_shared_memory(config: zenoh.Config) -> str:
    """Turn shared memory off in a configuration that turns it on, if this process may not lock as
    much as others may share with it; why, "" if it stays as it is.
    """
    if json.loads(config.get_json("transport/shared_memory/enabled")) is not True:
        return ""
    may_lock = lockable_bytes()
    if may_lock >= _LOCKED_AT_LEAST:
        return ""
    config.insert_json5("transport/shared_memory/enabled", "false")
    return (
        f"this process may lock {size_text(may_lock)} of memory, and would lose large messages of "
        f"others without a word: let it lock {size_text(_LOCKED_AT_LEAST)} (ulimit -l, "
        "LimitMEMLOCK of systemd)"
    )


# From Linux's <linux/capability.h>.
_MAY_LOCK_ALL = 1 << 14


def lockable_bytes() -> int:
    """How much memory this process may lock, 2^63 without a limit."""
    unlimited: int = 2**63
    try:
        import resource
    except ImportError:  # Windows
        return unlimited
    with suppress(OSError, StopIteration, ValueError):  # not Linux
        with open("/proc/self/status") as lines:
            capabilities = next(line for line in lines if line.startswith("CapEff:"))
        if int(capabilities.split()[1], 16) & _MAY_LOCK_ALL:
            return unlimited
    soft = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0]
    return unlimited if soft == resource.RLIM_INFINITY else soft


def _retry(network: Network) -> dict[str, int]:
    """How soon a failed try to open a link is repeated."""
    return {
        "period_init_ms": round(network.retry_s * 1e3),
        "period_max_ms": round(network.longest_s * 1e3),
        "period_increase_factor": 2,
    }


def _of_bad_network(network: Network) -> dict[str, Any]:
    """Further settings for a network that loses or delays packets."""
    return {
        "transport/link/tx/keep_alive": 2 * _KEEP_ALIVES,
        "transport/link/tx/batch_size": network.packet_bytes,
        # As many as Zenoh takes: while TCP repeats a lost packet, messages of topics wait here.
        "transport/link/tx/queue/size/data": _TOPIC_BATCHES,
        # One that opens a link to us is not given up before it gives up itself.
        "transport/unicast/accept_timeout": round(network.open_s * 1e3),
    }


def _with_datagrams(endpoints: Iterable[str]) -> list[str]:
    """These endpoints and, beside each of TCP, one of UDP for messages that may be lost."""
    found = []
    for each in endpoints:
        protocol, _, address = each.partition("/")
        if protocol == "tcp" and not {"?", "#"} & {*address}:
            found += [f"{each}?rel=1", f"udp/{address}{_DATAGRAMS}"]
        else:
            found.append(each)
    return found


def _has_udp(config: zenoh.Config) -> bool:
    """Whether an endpoint of this configuration is one of UDP."""
    ends = config.get_json("connect/endpoints") + config.get_json("listen/endpoints")
    return '"udp/' in ends


def _with_access_control(config: zenoh.Config, control: dict[str, Any]) -> zenoh.Config:
    if len(control["rules"]) < _MANY_RULES:
        config.insert_json5("access_control", json.dumps(control))
        return config
    # Zenoh reads 1 MB of JSON, the rules of 200 identities, in 0.6 s; as YAML, which JSON is too,
    # in 0.1 s. That only from a file.
    import tempfile  # which only large rules need

    whole = json.dumps({**json.loads(str(config)), "access_control": control})
    with tempfile.TemporaryDirectory(prefix="tfbus") as folder:
        path = os.path.join(folder, "zenoh.yaml")
        with open(path, "w", encoding="utf-8") as file:
            file.write(whole)
        return zenoh.Config.from_file(path)


def _encrypted(folder: "SecureFolder", window: int | None, *, carried: bool) -> dict[str, Any]:
    """The settings that encrypt every link, offer this window on it, in bytes, and let in only
    messages that the rights allow; if it is `carried`, all from its own identity, which carries
    messages of others to it.
    """
    from tfbus.bus.rights import access_control

    identity = folder.identity
    # All links of such a client are those to its router, which a robot runs by its own identity.
    control = access_control(folder.rights.seen_by(identity), identity.name if carried else "")
    certificate, key = str(folder.certificate), str(folder.key)
    tls = {
        "root_ca_certificate": str(folder.authority),
        "enable_mtls": True,
        "listen_certificate": certificate,
        "listen_private_key": key,
        "connect_certificate": certificate,
        "connect_private_key": key,
        # Scouting finds addresses; the certificate says whose they are, and their rights.
        "verify_name_on_connect": folder.rights.names_hosts,
        "close_link_on_expiration": True,
        "so_rcvbuf": window,
    }
    return {
        "transport/link/protocols": ["tls"],
        "transport/link/tls": tls,
        "access_control": _canonical(control),
    }


def _canonical(control: dict[str, Any]) -> dict[str, Any]:
    """Access control with key expressions in the one form that Zenoh takes: `*/**` for `**/*`."""
    for rule in control["rules"]:
        keys = [str(zenoh.KeyExpr.autocanonize(key)) for key in rule["key_exprs"]]
        rule["key_exprs"] = list(dict.fromkeys(keys))
    return control


def id_in_file(path: str) -> str | None:
    """Zenoh's id that the configuration file sets, as sessions tell theirs; None without one."""
    named = _named_in_file(path)
    return str(named["id"]).lower() if _is_in(named, "id") and named["id"] else None


def has_scouting(settings: NodeSettings) -> bool:
    """Whether a session with these settings scouts by multicast."""
    enabled = json.loads(_config_of(settings.config).get_json("scouting/multicast/enabled"))
    has_router = settings.mode == "client" and bool(settings.connect)
    return enabled is not False and not has_router


def listens_beyond_loopback(config: zenoh.Config) -> tuple[str, ...]:
    """The endpoints of a configuration on which other hosts reach its session."""
    return tuple(endpoint for endpoint in _listen(config) if not _is_of_loopback(endpoint))


def scouting_of(config: zenoh.Config, settings: NodeSettings) -> Scouting | None:
    """How a session of this configuration takes part in scouting.

    None if it does not: a client, one without multicast, or one whose group is of IPv6.
    """
    role = _mode(config)
    group = _GROUP.fullmatch(_value(config, "address") or _DEFAULT_GROUP)
    if role == "client" or _value(config, "enabled") is False or group is None:
        return None
    named = _named_in_file(settings.config)
    only = _value(config, "interface") if _is_in(named, _INTERFACE) else "auto"
    connects = _value(config, "autoconnect")
    return Scouting(
        role,
        tuple(_listen(config)),
        (group[1], int(group[2])),
        ttl=_value(config, "ttl") or 1,
        only=() if only in (None, "", "auto") else tuple(map(str.strip, only.split(","))),
        answers=_for_mode(_value(config, "listen"), role) is not False,
        connects=role == "peer" and _for_mode(connects, role) not in ([], ""),
    )


def datagram_ports(config: zenoh.Config) -> list[int]:
    """The ports at which a session of this configuration takes datagrams beside other links."""
    ends = [split_endpoint(each) for each in _listen(config) if _DATAGRAMS in each]
    return [port for *_, port in ends if port]


def lease_s(config: zenoh.Config) -> float:
    """The time after which a silent link of this configuration is lost."""
    return float(json.loads(config.get_json("transport/link/tx/lease"))) / 1e3


def _value(config: zenoh.Config, key: str) -> Any:
    return json.loads(config.get_json(f"scouting/multicast/{key}"))


def _mode(config: zenoh.Config) -> str:
    return json.loads(config.get_json("mode")) or "peer"


def _listen(config: zenoh.Config) -> list[str]:
    return _for_mode(json.loads(config.get_json("listen/endpoints")), _mode(config)) or []


def _for_mode(value: Any, mode: str) -> Any:
    """The value for one mode, of a setting that may have one for each."""
    return value.get(mode) if isinstance(value, dict) else value


def _is_of_loopback(endpoint: str) -> bool:
    protocol, _, address = endpoint.partition("/")
    host = address.partition("#")[0].rpartition(":")[0].strip("[]")
    return protocol.startswith("unix") or is_local(host)


def _named_in_file(path: str) -> Any:
    """The keys that the file itself sets: in Zenoh's configuration it looks like the defaults."""
    if not path:
        return {}
    with open(path, encoding="utf-8") as file:
        text = file.read()
    if path.endswith(".yaml"):
        import yaml  # slow to import, and most sessions have no such file

        return yaml.safe_load(text)
    # Zenoh takes any value for this key, so it can read JSON5 for us.
    reader = zenoh.Config()
    reader.insert_json5("metadata", text)
    return json.loads(reader.get_json("metadata"))


def _is_in(named: Any, key: str) -> bool:
    """Whether a key such as `transport/link` is in nested dictionaries."""
    first, _, rest = key.partition("/")
    return isinstance(named, dict) and first in named and (not rest or _is_in(named[first], rest))


def _config_of(path: str) -> zenoh.Config:
    try:
        return zenoh.Config.from_file(path) if path else zenoh.Config()
    except zenoh.ZError as error:
        # Zenoh draws the position over several lines; the first and the last say it all.
        drawn = first_sentence(str(error)).splitlines()
        reason = ", ".join(dict.fromkeys(line.strip(" =->|") for line in (drawn[0], drawn[-1])))
        raise SettingsError(
            f"{path} is not a configuration of Zenoh, in JSON5: {reason}"
        ) from error
