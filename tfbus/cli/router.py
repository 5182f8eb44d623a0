"""`tfbus router`: Zenoh's router, without an installed zenohd."""

import logging
import math
from contextlib import closing, suppress
from dataclasses import replace

import click

from tfbus.base.errors import BusError
from tfbus.base.executor import Executor
from tfbus.base.log import LogOnce, open_log
from tfbus.base.signals import StopSignals
from tfbus.bus.presence import watch_nodes
from tfbus.bus.session import Session
from tfbus.bus.settings import AUTO, NodeSettings
from tfbus.command.options import bus_options, interruptible
from tfbus.node.surroundings import watch_endpoints, watch_members

DEFAULT_ENDPOINT = "tcp/[::]:7447"
_SAY_AGAIN_AFTER_S = 60.0
SECURE_ENDPOINT = "tls/[::]:7447"


@click.command(epilog="Example: tfbus router --listen tcp/[::]:7447")
@click.option(
    "--hub",
    metavar="ENDPOINT",
    help="Be the router of one site of many: this router tells it what is wanted here.",
)
@bus_options("router")
@interruptible
def command(settings: NodeSettings, hub: str | None) -> None:
    """Run a Zenoh router, which connects networks.

    Nodes reach it with `--connect tcp/HOST:7447`; with `--mode client`, all their messages go
    through it. Routers join each other with `--connect`, and then each knows of everything; with
    `--hub` a router knows of its own site, and of what is asked for there.
    """
    if hub is not None and settings.connect:
        raise click.UsageError(
            "--hub names the one router that this one joins: omit --connect and TFBUS_CONNECT"
        )
    endpoint = SECURE_ENDPOINT if settings.secure else DEFAULT_ENDPOINT
    listen = settings.listen or (() if settings.config else (endpoint,))
    if hub is None:
        settings, patience_s = replace(settings, mode="router", listen=listen), 0.0
    else:
        # A client that listens passes on what its own clients send, and asks for.
        settings = replace(settings, mode="client", listen=listen or (endpoint,), connect=(hub,))
        patience_s = math.inf
    # Which network is that of the way to the hub shows once there is one.
    opens_alone = hub is not None and settings.network != AUTO
    log = open_log("/router", settings.name, settings.log_level)
    signals = StopSignals()
    with (
        Session(settings, log, patience_s=patience_s, opens_alone=opens_alone) as session,
        closing(Executor("router", log)) as executor,
    ):
        watch_members(session, log)
        watch_endpoints(session, executor, log)
        _log_links(session, log)
        where = ", ".join(settings.listen) or f"the endpoints of {settings.config}"
        is_open = " (the bus is open; --secure closes it)" if session.open_to else ""
        log.info("Routing on %s%s", where, is_open)
        if session.without_datagrams:
            log.info("No datagrams: %s", session.without_datagrams)
        if hub is not None:
            executor.submit("hub", lambda: _watch_hub(session, executor, log))
        signals.wait()
    signals.uninstall()


def _watch_hub(session: Session, executor: Executor, log: logging.Logger) -> None:
    """Say each minute that the hub is not there."""
    with suppress(BusError):  # it is closed meanwhile
        if not session.routers():
            log.warning(
                "Waiting for a router%s; what is within this site needs none",
                session.why_no_router(),
            )
        executor.after(_SAY_AGAIN_AFTER_S, lambda: _watch_hub(session, executor, log))


def _log_links(session: Session, log: logging.Logger) -> None:
    """Log arrivals and departures: of the nodes of the bus by name, of linked routers by id and
    address.
    """
    # A node on a bad link comes and goes; the lines about it count the times.
    once = LogOnce(log, again_s=_SAY_AGAIN_AFTER_S)

    def on_router(zid: str, linked: bool) -> None:
        if not linked:
            once.info((linked, zid), "Lost router %s", zid)
        else:
            where = session.address_of(zid) or "an unknown address"
            once.info((linked, zid), "Linked to router %s at %s", zid, where)

    def on_node(name: str, alive: bool) -> None:
        # The names of tools begin so: they come for a moment, to look.
        if not name.rpartition("/")[2].startswith("_"):
            once.info((alive, name), "%s has %s", name, "joined" if alive else "left")

    session.watch_routers(on_router)
    watch_nodes(session, on_node)
