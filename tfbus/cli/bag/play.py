"""`tfbus bag play`: replays a recording on the bus."""

import gc
import re
import sys
import threading
import time
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tfbus.bus.settings import NodeSettings
from tfbus.cli.bag.ros_options import OF_PLAY
from tfbus.cli.bag.selecting import Asked, selecting
from tfbus.cli.bag.sources import RECORDING
from tfbus.cli.output import is_terminal
from tfbus.cli.verbs import Answering
from tfbus.command.moment import Moment
from tfbus.command.option_kinds import Several
from tfbus.command.options import bus_options
from tfbus.command.recordings import open_recording, wall
from tfbus.command.types import NOT_NEGATIVE, POSITIVE, MomentType, Number
from tfbus.errors import TfbusError
from tfbus.recording.playhead import FASTEST, SLOWEST, AtEnd
from tfbus.recording.selection import Selection, is_of_transforms
from tfbus.wording import counted, did_you_mean, duration, printable

if TYPE_CHECKING:
    from tfbus.bag.player import Player
    from tfbus.bag.replay import Republisher, Stamps
    from tfbus.bag.replayed_stream import ReplayedNames
    from tfbus.node.node import Node
    from tfbus.recording.reader import RecordingReader

_LOOK_EVERY_S = 0.1
_LOG_EVERY_S = 10.0

# How often the time is published, as ros2 bag does.
_CLOCK_HZ = 40.0

# After a seek, frames are where they were last within this time.
_LOOK_BACK_S = 2.0

# With that, threads take turns often enough for the player to be on time.
_SWITCH_INTERVAL_S = 0.0001


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


@dataclass(frozen=True)
class _Plan:
    """The options of the command line."""

    files: tuple[Path, ...]
    selection: Selection
    names: "ReplayedNames"
    start: Moment | None
    until: Moment | None
    duration_s: float | None
    rate: float
    at_end: AtEnd
    stamps: "Stamps"
    clock_hz: float | None
    is_paused: bool
    delay_s: float
    is_quiet: bool
    has_keys: bool
    force: bool


@click.command(
    "play",
    cls=_Play,
    hints=OF_PLAY,
    epilog="Examples: tfbus bag play run.mcap; tfbus bag play run.mcap --start 60 --rate 2 --loop; "
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
    "--start",
    "--start-offset",
    type=MomentType(),
    metavar="TIME",
    help="Start at this moment: 10 is 10 s after the beginning, -10 is 10 s before the end; or a "
    "date and time, or seconds since 1970.",
)
@click.option(
    "--until",
    "--playback-until-sec",
    "--playback-until-nsec",
    "until",
    type=MomentType(),
    metavar="TIME",
    help="End at this moment, written as that of --start.",
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
@selecting("Play")
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
    stamps: "Stamps | None",
    clock_hz: float | None,
    asked: Asked,
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
    from tfbus.bag.replayed_stream import ReplayedNames

    if not (files or more_files):
        raise click.UsageError("name the recording to play: tfbus bag play FILE")
    if clock_hz is not None and stamps == "now":
        raise click.UsageError("--clock is the recorded time, which --stamps now does not follow")
    try:
        settings = settings.renamed(node_name) if node_name else settings.named_by_default("player")
        plan = _Plan(
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
    with open_recording(*plan.files) as reader:
        _check_names(reader, plan)
        _play(settings, reader, plan)


def _full(name: str) -> str:
    return name.removeprefix("/")


def _pair(text: str) -> tuple[str, str]:
    old, sign, new = text.partition(":=")
    if not (old and sign and new):
        raise click.UsageError(f"'{printable(text, 60)}' is not of the form --remap FROM:=TO")
    return old, new


def _check_names(reader: "RecordingReader", plan: _Plan) -> None:
    """Raises click.UsageError for a topic or stream that is not in the recording."""
    topics = {topic.name for topic in reader.topics}
    streams = {each.stream.name for each in reader.streams}
    asked = [
        *(("topic", name, topics) for name in plan.selection.topics if not is_of_transforms(name)),
        *(("stream", name, streams) for name in plan.selection.streams),
        *(("topic or stream", _full(old), topics | streams) for old in plan.names.remappings),
    ]
    for kind, name, known in asked:
        if name not in known:
            raise click.UsageError(
                f"there is no {kind} '{printable(name, 60)}' in the recording"
                f"{did_you_mean(name, known, none='')}"
            )


def _span(reader: "RecordingReader", plan: _Plan) -> tuple[int, int]:
    """From when to when it is played, in log times; a click.UsageError if that is nothing."""
    first_ns, last_ns = reader.start_ns, reader.end_ns
    start_ns = first_ns if plan.start is None else plan.start.within(first_ns, last_ns)
    end_ns = last_ns if plan.until is None else plan.until.within(first_ns, last_ns)
    if plan.duration_s is not None:
        end_ns = min(end_ns, max(start_ns, first_ns) + round(plan.duration_s * 1e9))
    mistake = ""
    if start_ns > last_ns:
        mistake = f"--start, {wall(start_ns)}, is after its end"
    elif end_ns < first_ns:
        mistake = f"--until, {wall(end_ns)}, is before its beginning"
    elif end_ns < start_ns:
        mistake = f"--until, {wall(end_ns)}, is before --start, {wall(start_ns)}"
    if mistake:
        raise click.UsageError(
            f"the recording is from {wall(first_ns)} to {wall(last_ns)} "
            f"({duration((last_ns - first_ns) / 1e9)}): {mistake}"
        )
    return start_ns, end_ns


def _play(settings: NodeSettings, reader: "RecordingReader", plan: _Plan) -> None:
    from tfbus.bag.player import Player
    from tfbus.bag.replay import Republisher, serve
    from tfbus.bag.replayed_time import clock_topic_of
    from tfbus.cli.bag.play_status import PlayLine, end_text
    from tfbus.node.node import Node

    start_ns, end_ns = _span(reader, plan)
    clocks = () if plan.clock_hz is None else tuple(filter(None, (clock_topic_of(reader),)))
    selection = replace(plan.selection, always=clocks)
    player = Player(
        reader,
        selection=selection,
        start_ns=start_ns,
        end_ns=end_ns,
        rate=plan.rate,
        paused=plan.is_paused,
        at_end=plan.at_end,
        lasting=clocks,
        look_back_s=_LOOK_BACK_S,
    )
    line = PlayLine()
    error: Exception | None = None
    with Node.from_settings(settings) as node:
        node.log.addFilter(line.clear)
        replay = Republisher(
            node,
            reader,
            player,
            selection=selection,
            names=plan.names,
            stamps=plan.stamps,
            clock_hz=plan.clock_hz,
        )
        serve(node, player, node.shutdown)
        node.session.settle()
        _check_living(node, replay, plan)
        run = _Run(player, replay)
        began_s = time.monotonic()
        try:
            if node.wait(plan.delay_s):
                if plan.delay_s:
                    _check_living(node, replay, plan)
                began_s = time.monotonic()
                _be_punctual()
                run.start()
                _go_on(node, plan, player, replay, run, line)
        except KeyboardInterrupt:
            pass  # the usual end
        finally:
            line.clear()
            run.stop()
            error = run.error
        if error is None and not plan.is_quiet:
            node.log.info(end_text(player.progress, time.monotonic() - began_s))
    if isinstance(error, TfbusError | OSError):
        raise click.ClickException(f"stopped playing: {error}") from error
    if error is not None:
        raise error


def _check_living(node: "Node", replay: "Republisher", plan: _Plan) -> None:
    """Raises click.ClickException if a stream is published now, unless that is wanted."""
    living = replay.living()
    if living and not plan.force:
        raise click.ClickException(f"{living}; --force plays nevertheless")
    if living:
        node.log.warning("%s", living)


def _be_punctual() -> None:
    """Have Python stop the player's thread for no longer than it must, from now on."""
    sys.setswitchinterval(_SWITCH_INTERVAL_S)
    # What is there by now stays: to look through all of it for garbage takes 30 ms.
    gc.collect()
    gc.freeze()


class _Run:
    """A player that plays on a thread of its own; `error` is what ended it before its end."""

    def __init__(self, player: "Player", replay: "Republisher") -> None:
        self.error: Exception | None = None
        self._player = player
        self._replay = replay
        self._thread = threading.Thread(target=self._run, name="player", daemon=True)

    @property
    def goes_on(self) -> bool:
        """Whether it has not come to its end."""
        return self._thread.is_alive()

    def start(self) -> None:
        """Play."""
        self._thread.start()

    def stop(self) -> None:
        """End it; twice is fine."""
        self._player.stop()
        if self._thread.ident is not None:
            self._thread.join()

    def _run(self) -> None:
        try:
            self._player.run(self._replay)
        except Exception as error:  # raised again in the main thread
            self.error = error


def _go_on(
    node: "Node", plan: _Plan, player: "Player", replay: "Republisher", run: _Run, line: Any
) -> None:
    """Show how far it is and follow keys, to the end, Ctrl-C, or the service `stop`."""
    from tfbus.cli.bag.play_keys import KEYS, follow
    from tfbus.cli.bag.play_status import log_text
    from tfbus.cli.bag.typed_keys import typed_keys

    shows = is_terminal() and not plan.is_quiet
    logged_s, was_paused = time.monotonic(), plan.is_paused
    with typed_keys(_LOOK_EVERY_S, wanted=plan.has_keys) as read_keys:
        node.ready(_what(plan, player, replay) + (f"; {KEYS}" if read_keys and shows else ""))
        while node.ok and run.goes_on:
            if read_keys is None:
                if not node.wait(_LOOK_EVERY_S):
                    return
            elif not all(follow(key, player) for key in read_keys()):
                return
            progress = player.progress
            now_s = time.monotonic()
            if shows:
                line.show_progress(progress)
            elif not plan.is_quiet and (
                progress.is_paused is not was_paused or now_s >= logged_s + _LOG_EVERY_S
            ):
                node.log.info(log_text(progress))
                logged_s, was_paused = now_s, progress.is_paused


def _what(plan: _Plan, player: "Player", replay: "Republisher") -> str:
    """The recording that is played, in one line."""
    what = [counted(len(replay.streams), "stream"), counted(len(replay.topics), "topic")]
    stamps = "stamps are moved to now" if plan.stamps == "now" else "stamps are those recorded"
    state = ", paused" if plan.is_paused else ""
    rate = f" at rate {plan.rate:g}" if plan.rate != 1.0 else ""
    return (
        f"Playing {duration(player.progress.duration_s)}{rate}{state}: {', '.join(what)}; {stamps}"
    )
