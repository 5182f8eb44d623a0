"""Looking for others by multicast."""

import threading

import zenoh

from tfbus.bus.handles import direct
from tfbus.bus.settings import NodeSettings
from tfbus.bus.zenoh_config import zenoh_config
from tfbus.bus.zenoh_errors import bus_errors


def found_by_scouting(settings: NodeSettings, timeout_s: float, *, until: str) -> set[str]:
    """The ids of the peers and routers that scouting finds, ended when `until` is among them."""
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
