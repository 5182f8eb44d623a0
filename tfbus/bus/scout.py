"""Which peers and routers answer multicast scouting."""

from collections.abc import Callable
from typing import Any

import zenoh

from tfbus.bus import zenoh_library
from tfbus.bus.callbacks import direct
from tfbus.bus.settings import NodeSettings
from tfbus.bus.zenoh_config import zenoh_config
from tfbus.bus.zenoh_library import bus_errors, configure_zenoh_threads
from tfbus.runtime import scheduler

# For each process its id and its endpoints.
Hellos = dict[str, tuple[str, ...]]


def scout(
    settings: NodeSettings,
    timeout_s: float,
    *,
    until: Callable[[str, tuple[str, ...]], bool],
    what: str = "peer|router",
) -> Hellos:
    """The peers and routers that answer within `timeout_s`, or until `until(id, endpoints)` is true
    of one. Raises BusError if this host cannot ask.
    """
    zenoh_library.begin_use()
    configure_zenoh_threads()
    found: Hellos = {}
    is_found = scheduler.Event()

    def on_hello(hello: zenoh.Hello) -> None:
        zid, endpoints = str(hello.zid), tuple(hello.locators)
        found[zid] = endpoints
        if until(zid, endpoints):
            is_found.set()

    with bus_errors("look for others by scouting"):
        scout = _scout(direct(on_hello), what, settings)
    is_found.wait(timeout_s)
    scout.stop()
    return found.copy()


def _scout(handler: Any, what: str, settings: NodeSettings) -> Any:
    network = zenoh_library.simulated()
    if network is not None:
        return network.scout(handler, what)
    return zenoh.scout(handler, what=what, config=zenoh_config(settings))
