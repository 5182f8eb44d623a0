"""How Zenoh is set: by a node's settings, by its configuration file, and where neither does."""

import json
from pathlib import Path
from typing import Any

import yaml
import zenoh

from tfbus.bus.interfaces import loopback_where_alone
from tfbus.bus.settings import NodeSettings
from tfbus.bus.zenoh_errors import first_sentence
from tfbus.errors import SettingsError

# How long a link may be silent before its tokens are lost; Zenoh fills it with four signs of life.
_LEASE_MS = 1500

# So many batches of 64 KiB of urgent messages wait on a link before one is dropped: a burst of
# 10,000 transforms on as many keys lost up to 2,000 of them with Zenoh's two.
_URGENT_BATCHES = 8

# Of two peers that another introduces one calls the other. By Zenoh's own "always" both do, and
# have two links. After a host was unplugged one of them stayed, and with it tokens of who was away;
# and such a link may be in half for good (eclipse-zenoh/zenoh#2806). In return a peer that can call
# and cannot be called meets only those that have smaller ids.
_ONE_CALLS = {"peer": {"to_router": "always", "to_peer": "greater-zid"}}


def zenoh_config(settings: NodeSettings, scouting_s: float | None = None) -> zenoh.Config:
    """Zenoh's configuration for these settings: the file's, with what is given put over it.

    `scouting_s` is how long others are looked for before the session opens without any.
    Raises SettingsError where the file is not one.
    """
    config = _config_of(settings.config)
    named = _named_in_file(settings.config)
    defaults = {
        # Retained messages carry a time, by which late joiners order them.
        "timestamping/enabled": True,
        "scouting/multicast/interface": loopback_where_alone(),
        "scouting/gossip/autoconnect_strategy": _ONE_CALLS,
        # A host that was unplugged is noticed after this time; Zenoh's own is 10 s.
        "transport/link/tx/lease": _LEASE_MS,
        "transport/link/tx/queue/size/interactive_high": _URGENT_BATCHES,
        # Zenoh looks after it 30 times a second, as much CPU as all else of an idle session.
        "transport/shared_memory": {"enabled": False},
    }
    given: dict[str, Any] = {
        "namespace": settings.namespace,
        "mode": settings.mode,
        "connect/endpoints": list(settings.connect),
        "listen/endpoints": list(settings.listen),
    }
    if scouting_s is not None:
        given["scouting/delay"] = given["scouting/timeout"] = round(scouting_s * 1e3)
    unnamed = {key: value for key, value in defaults.items() if not _is_in(named, key)}
    for key, value in {**unnamed, **given}.items():
        if value:
            config.insert_json5(key, json.dumps(value))
    return config


def has_scouting(settings: NodeSettings) -> bool:
    """Whether a session with these settings looks for others by multicast."""
    enabled = json.loads(_config_of(settings.config).get_json("scouting/multicast/enabled"))
    is_told_where = settings.mode == "client" and bool(settings.connect)
    return enabled is not False and not is_told_where


def _named_in_file(path: str) -> Any:
    """The keys that the file itself names: a configuration does not tell them from defaults."""
    if not path:
        return {}
    text = Path(path).read_text(encoding="utf-8")
    if path.endswith(".yaml"):
        return yaml.safe_load(text)
    # Zenoh takes any value for this key, and so reads JSON5 for us.
    reader = zenoh.Config()
    reader.insert_json5("metadata", text)
    return json.loads(reader.get_json("metadata"))


def _is_in(named: Any, key: str) -> bool:
    """Whether a key such as `transport/link` is in dictionaries within each other."""
    first, _, rest = key.partition("/")
    return isinstance(named, dict) and first in named and (not rest or _is_in(named[first], rest))


def _config_of(path: str) -> zenoh.Config:
    try:
        return zenoh.Config.from_file(path) if path else zenoh.Config()
    except zenoh.ZError as error:
        # Zenoh draws the place over several lines, the first and the last of which say it all.
        drawn = first_sentence(str(error)).splitlines()
        reason = ", ".join(dict.fromkeys(line.strip(" =->|") for line in (drawn[0], drawn[-1])))
        raise SettingsError(
            f"{path} is not a configuration of Zenoh, in JSON5: {reason}"
        ) from error
