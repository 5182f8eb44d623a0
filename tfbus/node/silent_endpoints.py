"""Warns of endpoints to connect to that do not answer, also if others are found without them."""

import logging
from contextlib import suppress

from tfbus.bus.endpoints import why_unreachable
from tfbus.bus.session import Session
from tfbus.errors import BusError
from tfbus.runtime import scheduler
from tfbus.runtime.executor import Executor
from tfbus.wording import counted, listed

# A router that is started together with the node answers by then.
_AFTER_S = 5.0


def watch_endpoints(session: Session, executor: Executor, log: logging.Logger) -> None:
    """Look once, after some seconds, unless a router is connected by then. A client waits for its
    router, and says so itself.
    """
    endpoints = session.settings.connect
    if session.settings.mode == "client" or not endpoints:
        return

    def look() -> None:
        with suppress(BusError):  # it is closed meanwhile
            if not session.routers():
                # A host that is not there takes 2 s, in which callbacks of the node go on.
                scheduler.Thread(target=ask, name="endpoints", daemon=True).start()

    def ask() -> None:
        whys = {endpoint: why_unreachable(endpoint) for endpoint in endpoints}
        if silent := [f"{endpoint} ({why})" for endpoint, why in whys.items() if why]:
            executor.submit("endpoints", lambda: warn(silent))

    def warn(silent: list[str]) -> None:
        with suppress(BusError):
            links = counted(len(session.linked()), "link")
            log.warning(
                "Nothing answers at %s: still trying; %s to other processes without it",
                listed(silent),
                links,
            )

    executor.after(_AFTER_S, look)
