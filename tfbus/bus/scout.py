"""Which peers and routers answer multicast scouting."""

import threading

import zenoh

from tfbus.bus import forks
from tfbus.bus.callbacks import direct
from tfbus.bus.settings import NodeSettings
from tfbus.bus.zenoh_config import zenoh_config
from tfbus.bus.zenoh_errors import bus_errors
from tfbus.bus.zenoh_threads import configure_zenoh_threads


def found_by_scouting(settings: NodeSettings, timeout_s: float, *, until: str) -> set[str]:
    """The ids of the peers and routers that answer within `timeout_s`, or until `until` does."""
    forks.begin()
    configure_zenoh_threads()
    found: set[str] = set()
    is_found = threading.Event()

    def on_hello(hello: zenoh.Hello) -> None:
        found.add(str(hello.zid))
        if until in found:
            is_found.set()

    with bus_errors("look for others by scouting"):
        scout = zenoh.scout(direct(on_hello), what="peer|router", config=zenoh_config(settings))
    is_found.wait(timeout_s)
    scout.stop()
    return found
