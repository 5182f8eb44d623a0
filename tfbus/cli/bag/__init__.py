"""The verbs of `tfbus bag`, each imported when it is used."""

from importlib import import_module
from types import ModuleType
from typing import Any, cast

import click

from tfbus.base.errors import TfbusError
from tfbus.cli import Verbs
from tfbus.command.options import click_error

# One line each, repeated here because importing all of them for `--help` is slow; a test compares
# them.
VERBS: dict[str, str] = {
    "cut": "Write a part of a recording into a new one.",
    "export": "Write where SOURCE was, seen from TARGET, or all transforms, or a topic.",
    "filter": "Write a recording without some of its topics, streams and frames.",
    "import": "Convert recordings of ROS or Foxglove: .bag, .db3, .mcap, or a folder of rosbag2.",
    "info": "Show what is in a recording: streams, rates, gaps, static transforms, topics, events.",
    "merge": "Write several recordings into one, in order of time.",
    "play": "Replay a recording: its streams, topics and static transforms, as they were.",
    "record": "Record the bus into an MCAP file: transforms, topics, and who was there.",
    "recover": "Write what can be read of a recording that is cut short or damaged.",
}

# Verbs that make recordings from others; each further verb has a file of its own.
_EDITS = ("cut", "filter", "import", "merge", "recover")

# Verbs of ros2 bag that have another name here.
_OF_BAG = {
    "burst": "use: tfbus bag play --rate 1000",
    "convert": "use: tfbus bag cut, merge, filter or export",
    "list": "recordings are MCAP files; tfbus bag import reads other formats",
    "reindex": "use: tfbus bag recover",
}


class _Bag(Verbs):
    def invoke(self, ctx: click.Context) -> Any:
        try:
            return super().invoke(ctx)
        except TfbusError as error:
            raise click_error(error) from error

    def list_commands(self, ctx: click.Context) -> list[str]:
        return sorted(VERBS)

    def get_command(self, ctx: click.Context, name: str) -> click.Command | None:
        if name not in VERBS:
            return None
        if name in _EDITS:
            return cast(click.Command, getattr(_module("edit"), f"{name}_command"))
        return cast(click.Command, _module(name).command)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl(sorted(VERBS.items()))


def _module(name: str) -> ModuleType:
    return import_module(f"tfbus.cli.bag.{name}")


@click.group(cls=_Bag, hints=_OF_BAG)
def command() -> None:
    """Record a bus, replay it, and cut, convert and repair recordings."""
