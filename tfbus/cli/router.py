"""`tfbus router`: Zenoh's router, without an installed zenohd."""

from dataclasses import replace

import click

from tfbus.bus.members import watch_members
from tfbus.bus.session import Session
from tfbus.bus.settings import NodeSettings
from tfbus.command.options import bus_options
from tfbus.runtime.log import open_log
from tfbus.runtime.signals import StopSignals

DEFAULT_ENDPOINT = "tcp/[::]:7447"
SECURE_ENDPOINT = "tls/[::]:7447"


@click.command(epilog="Example: tfbus router --listen tcp/[::]:7447")
@bus_options("router")
def command(settings: NodeSettings) -> None:
    """Run a Zenoh router, which connects networks.

    Nodes reach it with `--connect tcp/HOST:7447`; with `--mode client`, all their messages go
    through it. Routers join each other with `--connect`.
    """
    endpoint = SECURE_ENDPOINT if settings.secure else DEFAULT_ENDPOINT
    listen = settings.listen or (() if settings.config else (endpoint,))
    settings = replace(settings, mode="router", listen=listen)
    log = open_log("/router", settings.name, settings.log_level)
    signals = StopSignals()
    with Session(settings, log) as session:
        watch_members(session, log)
        where = ", ".join(listen) or f"the endpoints of {settings.config}"
        is_open = " (the bus is open; --secure closes it)" if session.open_to else ""
        log.info("Routing on %s%s", where, is_open)
        signals.wait()
    signals.uninstall()
