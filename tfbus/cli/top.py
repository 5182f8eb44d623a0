"""`tfbus top`: nodes, streams, frames and topics on one screen, live."""

import click

from tfbus.base.errors import TfbusError
from tfbus.base.installation import install_command
from tfbus.bus.settings import NodeSettings
from tfbus.cli.output import is_terminal
from tfbus.command.options import listening_options
from tfbus.frames.command_listener import listening
from tfbus.wire.fleet import Fleet


@click.command(epilog="Example: tfbus top")
@listening_options("_top")
def command(settings: NodeSettings, fleet: Fleet | None) -> None:
    """Watch nodes, streams, frames and topics on one screen."""
    try:
        from tfbus.top.app import show
        from tfbus.top.rows import TopSource
    except ImportError as error:
        raise TfbusError(
            f"top needs textual, which is not installed: {install_command('top')}"
        ) from error
    if not is_terminal():
        raise click.UsageError(
            "top needs a terminal: in scripts use tfbus frames, monitor or doctor with --json"
        )
    with listening(settings, fleet, goes_on=True) as heard:
        show(TopSource(heard))
