"""Zenoh's configuration in a network of rmw_zenoh: as ROS itself is configured, or a client."""

import json
import os
import re
from collections.abc import Sequence

import zenoh

from tfbus.bus.settings import check_endpoint
from tfbus.bus.zenoh_library import first_sentence
from tfbus.errors import SettingsError

# Where rmw_zenoh has its router.
ROUTER = "tcp/localhost:7447"

# Before an endpoint: link to other processes as well, as ROS's own do, instead of to it alone.
_PEER = "peer:"

# A router that does not answer within this time is tried again.
_OPEN_TIMEOUT_MS = 5000

# As Zenoh says what is wrong in JSON.
_MESSAGE = re.compile(r'msg: "(.*?)"')

# Larger messages are not read.
LARGEST = 16 << 20


def ros_config(endpoints: Sequence[str], session_id: str) -> zenoh.Config:
    """The configuration of a session with this id: a client of the router at one of the endpoints.

    With `peer:` before an endpoint it is a peer, which links to the processes that the router, or
    any of them, tells it of. Without endpoints it is configured as rmw_zenoh is, by
    ZENOH_SESSION_CONFIG_URI, else a client of tcp/localhost:7447; and ZENOH_CONFIG_OVERRIDE goes
    over it. Raises SettingsError for what is no endpoint or no configuration.
    """
    path = os.environ.get("ZENOH_SESSION_CONFIG_URI", "")
    for each in endpoints:
        check_endpoint(each.removeprefix(_PEER))
    values: dict[str, object] = {
        "id": session_id,
        # Late joiners order retained messages by their time.
        "timestamping/enabled": True,
        "transport/link/rx/max_message_size": 2 * LARGEST,
        # Zenoh polls it 30 times a second; ROS then sends by TCP.
        "transport/shared_memory": {"enabled": False},
    }
    if endpoints or not path:
        values |= _linked(endpoints or [ROUTER])
    what = path or "a configuration of Zenoh"
    try:
        config = zenoh.Config.from_file(path) if path else zenoh.Config()
        for key, value in values.items():
            config.insert_json5(key, json.dumps(value))
        if not endpoints:
            for key, text in _overrides():
                what = f"ZENOH_CONFIG_OVERRIDE: {key}"
                config.insert_json5(key, text)
    except (zenoh.ZError, OSError) as error:
        raise SettingsError(f"Zenoh does not take {what}: {_reason(error)}") from error
    return config


def _reason(error: Exception) -> str:
    text = first_sentence(str(error)).splitlines()[0]
    said = _MESSAGE.search(text)
    return said[1] if said else text


def _linked(endpoints: Sequence[str]) -> dict[str, object]:
    is_peer = any(each.startswith(_PEER) for each in endpoints)
    return {
        "mode": "peer" if is_peer else "client",
        "connect/endpoints": [each.removeprefix(_PEER) for each in endpoints],
        "listen/endpoints": ["tcp/localhost:0"] if is_peer else [],
        # A peer goes on to try; a client is opened again and again.
        "connect/timeout_ms": {"peer": -1, "client": 0},
        "connect/exit_on_failure": {"peer": False, "client": True},
        # By default 10 s, which a host that is unplugged would hold up the end of the process.
        "transport/unicast/open_timeout": _OPEN_TIMEOUT_MS,
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": True,
        "scouting/gossip/autoconnect": {"peer": ["router", "peer"]},
        "scouting/delay": 100,
    }


def _overrides() -> list[tuple[str, str]]:
    """As rmw_zenoh reads them: `mode="client";connect/endpoints=["tcp/robot:7447"]`."""
    pairs = []
    for part in os.environ.get("ZENOH_CONFIG_OVERRIDE", "").split(";"):
        key, is_pair, text = part.strip().partition("=")
        if is_pair:
            pairs.append((key.strip(), text.strip()))
        elif key:
            raise SettingsError(
                f"ZENOH_CONFIG_OVERRIDE has {key!r} without a value: it is KEY=VALUE;KEY=VALUE"
            )
    return pairs


def where(config: zenoh.Config) -> str:
    """The endpoints that a session with this configuration connects to, in words."""
    mode = json.loads(config.get_json("mode")) or "peer"
    endpoints = json.loads(config.get_json("connect/endpoints"))
    if isinstance(endpoints, dict):
        endpoints = endpoints.get(mode)
    return " or ".join(map(str, endpoints or ())) or "any address"
