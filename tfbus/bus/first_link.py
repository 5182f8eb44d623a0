"""Opens a client whose router is not there yet.

Zenoh opens no client without a link to a router, and tries again for ever once it has lost one. So
it gets one for an instant, to a router in this process. On a closed bus nothing passes on that
link, which has no certificate.
"""

import json
import os
from contextlib import ExitStack, suppress
from tempfile import TemporaryDirectory

import zenoh

from tfbus.base import scheduler

_LINK_PROTOCOLS = "transport/link/protocols"
_ENDPOINTS = "connect/endpoints"
_OF_THIS_HOST = "unixsock-stream"

# The end of that link is known at once.
_LOOK_AGAIN_S = 0.001


def open_alone(config: zenoh.Config) -> zenoh.Session:
    """Open a client that is linked to a router of its endpoints or, if none answers, to none; it
    tries them again for ever.

    Raises ZError, as for any client, on other systems than Linux.
    """
    with ExitStack() as ends:
        router = None
        with suppress(OSError, zenoh.ZError):
            folder = ends.enter_context(TemporaryDirectory(prefix="tfbus"))
            # The client tries this endpoint, too, for as long as it lives. By the open folder it
            # is nobody else's: no process can listen in a folder that was removed. So the folder
            # stays open.
            opened_folder = os.open(folder, os.O_RDONLY)
            endpoint = f"{_OF_THIS_HOST}//proc/self/fd/{opened_folder}/router"
            router = ends.enter_context(zenoh.open(_router_at(endpoint)))
            _add(config, _ENDPOINTS, endpoint)
            if json.loads(config.get_json(_LINK_PROTOCOLS)):  # else it has all
                _add(config, _LINK_PROTOCOLS, _OF_THIS_HOST)
        opened = zenoh.open(config)
        first = router and router.zid()
    while first in opened.info.routers_zid():
        scheduler.sleep(_LOOK_AGAIN_S)
    return opened


def _router_at(endpoint: str) -> zenoh.Config:
    """The configuration of a router that others of this host can reach, if they know where."""
    config = zenoh.Config()
    config.insert_json5("mode", '"router"')
    config.insert_json5("listen/endpoints", json.dumps([endpoint]))
    config.insert_json5("scouting", '{"multicast": {"enabled": false}, "delay": 1}')
    return config


def _add(config: zenoh.Config, key: str, text: str) -> None:
    """Add a text to a list of the configuration, as its last one."""
    texts = json.loads(config.get_json(key))
    config.insert_json5(key, json.dumps([*dict.fromkeys([*texts, text])]))
