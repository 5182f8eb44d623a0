"""`tfbus bag play`: replays a recording on the bus."""

import re
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import click

from tfbus.base.errors import TfbusError
from tfbus.base.wording import printable
from tfbus.bus.settings import NodeSettings
from tfbus.cli import Answering
from tfbus.cli.bag.files import (
    CALLED_IN_ROS,
    NO_SERVICES,
    RECORDING,
    SelectionOptions,
    selecting,
)
from tfbus.command.options import Several, bus_options
from tfbus.command.types import NOT_NEGATIVE, POSITIVE, Moment, MomentType, Number
from tfbus.recording.playhead import FASTEST, SLOWEST, Stamps

# How often the time is published, as ros2 bag does.
_CLOCK_HZ = 40.0


class _Play(Answering):
    """`--clock` may have a number after it, and need not."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Read the arguments, with the usual rate after a `--clock` without one."""
        return super().parse_args(ctx, [*_with_clock_rate(args)])


def _with_clock_rate(args: list[str]) -> Iterable[str]:
    for at, arg in enumerate(args):
        following = args[at + 1] if at + 1 < len(args) else ""
        if arg == "--clock" and not re.fullmatch(r"[\d.]+", following):
            yield f"--clock={_CLOCK_HZ:g}"
        else:
            yield arg


# Options of `ros2 bag play` that are not needed here, or have another name.
_OF_PLAY = {
    "-a": "not needed: all that was recorded is played",
    "--all": "not needed: all that was recorded is played",
    "--wait-for-all-acked": "not needed: there are no acknowledgements to wait for",
    "--read-ahead-queue-size": "not needed: the player reads ahead by itself",
    "--message-order": "messages are played in the order in which they were received",
    "--use-sim-time": "use --clock, which publishes the recorded time for nodes with --sim-time",
    "--clock-topics": "use --clock, with a rate in Hz after it",
    "--clock-topics-all": "use --clock, with a rate in Hz after it",
    "--publish-service-requests": NO_SERVICES,
    "--service-requests-source": NO_SERVICES,
    "--send-actions-as-client": NO_SERVICES,
    "--burst": "use --rate with a large number, or --pause and the key . for single messages",
    "--storage-config-file": "not needed: files are read as they are",
    "--disable-loan-message": "not needed: messages are never loaned",
    "--progress-bar-update-rate": "use --quiet for no progress",
}


@click.command(
    "play",
    cls=_Play,
    hints=CALLED_IN_ROS | _OF_PLAY,
    epilog="Examples: tfbus bag play run.mcap; tfbus bag play run.mcap --from 60 --rate 2 --loop; "
    "tfbus bag play run.mcap --clock",
)
@click.argument("files", metavar="FILE...", nargs=-1, type=RECORDING)
@click.option(
    "-i",
    "--input",
    "more_files",
    multiple=True,
    hidden=True,
    type=RECORDING,
)
@click.option(
    "-r",
    "--rate",
    type=Number(least=SLOWEST, most=FASTEST),
    default=1.0,
    show_default=True,
    help="Recorded seconds per second.",
)
@click.option("-l", "--loop", is_flag=True, help="Begin again at the end.")
@click.option(
    "--from",
    "--start",
    "--start-offset",
    "start",
    type=MomentType(),
    metavar="TIME",
    help="Start at this moment: 10 is 10 s after the beginning, -10 before the end; or a date "
    "and time, or seconds since 1970.",
)
@click.option(
    "--to",
    "--until",
    "--playback-until-sec",
    "--playback-until-nsec",
    "until",
    type=MomentType(),
    metavar="TIME",
    help="End at this moment, written as that of --from.",
)
@click.option(
    "--duration",
    "--playback-duration",
    "duration_s",
    type=POSITIVE,
    metavar="SECONDS",
    help="End after this many recorded seconds.",
)
@click.option(
    "--stamps",
    type=click.Choice(("now", "recorded")),
    help="Move the stamps of transforms, and in messages of topics, to now, the default, or leave "
    "them as they were recorded, the default with --clock.",
)
@click.option(
    "--clock",
    "clock_hz",
    type=Number(least=0.1, most=1000.0),
    metavar="[HZ]",
    help="Publish the recorded time for nodes with --sim-time, 40 times a second.",
)
@selecting
@click.option(
    "-m",
    "--remap",
    "remappings",
    cls=Several,
    multiple=True,
    metavar="FROM:=TO...",
    help="Give topics and streams other names.",
)
@click.option(
    "--prefix",
    default="",
    metavar="PATH",
    help="Play into this namespace, beside what is there: old/turtle1/pose.",
)
@click.option(
    "-p", "--pause", "--start-paused", "is_paused", is_flag=True, help="Wait for the space key."
)
@click.option(
    "-d",
    "--delay",
    "delay_s",
    type=NOT_NEGATIVE,
    default=0.0,
    metavar="SECONDS",
    help="Wait before it starts.",
)
@click.option(
    "--force",
    is_flag=True,
    help="Play also what other processes publish now, such as a live robot.",
)
@click.option("-s", "--storage", type=click.Choice(("mcap",)), hidden=True, expose_value=False)
@click.option("-q", "--quiet", "is_quiet", is_flag=True, help="Show no progress.")
@click.option(
    "--disable-keyboard-controls", "no_keys", is_flag=True, help="Take no keys in a terminal."
)
@click.option(
    "--node-name",
    "--name",
    metavar="NAME",
    help="The name of its node, and so of its services (default player).",
)
@bus_options("player")
def command(
    settings: NodeSettings,
    files: tuple[Path, ...],
    more_files: tuple[Path, ...],
    rate: float,
    loop: bool,
    start: Moment | None,
    until: Moment | None,
    duration_s: float | None,
    stamps: Stamps | None,
    clock_hz: float | None,
    asked: SelectionOptions,
    remappings: tuple[str, ...],
    prefix: str,
    is_paused: bool,
    delay_s: float,
    force: bool,
    is_quiet: bool,
    no_keys: bool,
    node_name: str | None,
) -> None:
    """Replay a recording: its streams, topics and static transforms, as they were.

    Several files, or a folder of them, are played as one. Stamps are moved to now, so that all
    tools show the frames as if they were live; with --clock they stay, and nodes with --sim-time
    follow the recorded time, its pauses and jumps.

    In a terminal the space key pauses, . plays one message and , the one before, the arrows seek by
    5 s and change the rate, q ends. The services player/pause, resume, toggle_paused, play_next,
    seek, set_rate, progress and stop do the same.
    """
    # numpy and Zenoh, which `--help` does not need.
    from tfbus.bag.replayed_stream import ReplayedNames
    from tfbus.cli.bag.play_run import PlayPlan, play

    if not (files or more_files):
        raise click.UsageError("name the recording to play: tfbus bag play FILE")
    if clock_hz is not None and stamps == "now":
        raise click.UsageError("--clock is the recorded time, which --stamps now does not follow")
    try:
        settings = settings.renamed(node_name) if node_name else settings.named_by_default("player")
        # It makes the time that others follow, and must not wait for one.
        settings = replace(settings, sim_time=False)
        plan = PlayPlan(
            files=(*files, *more_files),
            selection=asked.selection(),
            names=ReplayedNames(prefix, dict(map(_pair, remappings))),
            start=start,
            until=until,
            duration_s=duration_s,
            rate=rate,
            at_end="loop" if loop else "stop",
            stamps=stamps or ("now" if clock_hz is None else "recorded"),
            clock_hz=clock_hz,
            is_paused=is_paused,
            delay_s=delay_s,
            is_quiet=is_quiet,
            has_keys=not no_keys,
            force=force,
        )
    except TfbusError as error:
        raise click.UsageError(str(error)) from error
    play(settings, plan)


def _pair(text: str) -> tuple[str, str]:
    old, sign, new = text.partition(":=")
    if not (old and sign and new):
        raise click.UsageError(f"'{printable(text, 60)}' is not of the form --remap FROM:=TO")
    return old, new
