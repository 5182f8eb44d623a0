"""`tfbus router`: Zenoh's router, for those who have no zenohd."""

from dataclasses import replace

import click

from tfbus.bus.session import Session
from tfbus.bus.settings import NodeSettings
from tfbus.command.options import bus_options
from tfbus.runtime.log import open_log
from tfbus.runtime.signals import StopSignals

DEFAULT_ENDPOINT = "tcp/[::]:7447"


@click.command(epilog="Example: tfbus router --listen tcp/[::]:7447")
@bus_options("router")
def command(settings: NodeSettings) -> None:
    """Run a Zenoh router, where nodes of several networks meet.

    Nodes reach it by `--connect tcp/HOST:7447`, and `--mode client` sends all they say through
    it. Routers given `--connect` join each other.
    """
    listen = settings.listen or (() if settings.config else (DEFAULT_ENDPOINT,))
    settings = replace(settings, mode="router", listen=listen)
    log = open_log("/router", settings.name, settings.log_level)
    signals = StopSignals()
    with Session(settings, log):
        log.info("Routing on %s", ", ".join(listen) or f"what {settings.config} says")
        signals.wait()
    signals.uninstall()
