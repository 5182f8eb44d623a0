"""Runs a player on the bus: shows how far it is, follows keys, serves."""

import gc
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import click

from tfbus.bag.player import Player
from tfbus.bag.replay import Republisher, serve
from tfbus.bag.replayed_stream import ReplayedNames
from tfbus.bag.replayed_time import clock_topic_of
from tfbus.base.errors import TfbusError
from tfbus.base.wording import counted, cut, duration, wall
from tfbus.bus.settings import NodeSettings
from tfbus.cli.bag.files import check_recorded
from tfbus.cli.bag.record_status import StatusLine
from tfbus.cli.output import is_terminal, paint, width
from tfbus.command.recordings import open_recording
from tfbus.command.terminal import typed_keys
from tfbus.command.types import Moment
from tfbus.node.node import Node
from tfbus.recording.items import Selection, is_of_transforms
from tfbus.recording.playhead import AtEnd, Playhead, Progress, Stamps, nearest_rate
from tfbus.recording.reader import RecordingReader

_LOOK_EVERY_S = 0.1
_LOG_EVERY_S = 10.0

# After a seek, frames are where they were last within this time.
_LOOK_BACK_S = 2.0

# With that, threads take turns often enough for the player to be on time.
_SWITCH_INTERVAL_S = 0.0001


@dataclass(frozen=True)
class PlayPlan:
    """The options of the command line."""

    files: tuple[Path, ...]
    selection: Selection
    names: ReplayedNames
    start: Moment | None
    until: Moment | None
    duration_s: float | None
    rate: float
    at_end: AtEnd
    stamps: Stamps
    clock_hz: float | None
    is_paused: bool
    delay_s: float
    is_quiet: bool
    has_keys: bool
    force: bool


def _check_names(reader: RecordingReader, plan: PlayPlan) -> None:
    """Raises TfbusError for a topic or stream that is not in the recording."""
    topics = {topic.name for topic in reader.topics}
    streams = {each.stream.name for each in reader.streams}
    asked = (
        *(("topic", name, topics) for name in plan.selection.topics if not is_of_transforms(name)),
        *(("stream", name, streams) for name in plan.selection.streams),
        *(
            ("topic or stream", old.removeprefix("/"), topics | streams)
            for old in plan.names.remappings
        ),
    )
    check_recorded(asked)


def _span(reader: RecordingReader, plan: PlayPlan) -> tuple[int, int]:
    """From when to when it is played, in log times; a click.UsageError if that is nothing."""
    first_ns, last_ns = reader.start_ns, reader.end_ns
    start_ns = first_ns if plan.start is None else plan.start.within(first_ns, last_ns)
    end_ns = last_ns if plan.until is None else plan.until.within(first_ns, last_ns)
    if plan.duration_s is not None:
        end_ns = min(end_ns, max(start_ns, first_ns) + round(plan.duration_s * 1e9))
    mistake = ""
    if start_ns > last_ns:
        mistake = f"--from, {wall(start_ns)}, is after its end"
    elif end_ns < first_ns:
        mistake = f"--to, {wall(end_ns)}, is before its beginning"
    elif end_ns < start_ns:
        mistake = f"--to, {wall(end_ns)}, is before --from, {wall(start_ns)}"
    if mistake:
        raise click.UsageError(
            f"the recording is from {wall(first_ns)} to {wall(last_ns)} "
            f"({duration((last_ns - first_ns) / 1e9)}): {mistake}"
        )
    return start_ns, end_ns


def play(settings: NodeSettings, plan: PlayPlan) -> None:
    """Play until the end, Ctrl-C or the service `stop`."""
    with open_recording(*plan.files) as reader:
        _check_names(reader, plan)
        _play(settings, reader, plan)


def _play(settings: NodeSettings, reader: RecordingReader, plan: PlayPlan) -> None:
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


def _check_living(node: Node, replay: Republisher, plan: PlayPlan) -> None:
    """Raises click.ClickException if a stream is published now, unless that is wanted."""
    living = replay.living()
    if living and not plan.force:
        raise click.ClickException(f"{living}; --force plays nevertheless")
    if living:
        node.log.warning("%s", living)


def _be_punctual() -> None:
    """Have Python stop the player's thread for no longer than it must, from now on."""
    sys.setswitchinterval(_SWITCH_INTERVAL_S)
    # The objects so far stay: to look through all of them for garbage takes 30 ms.
    gc.collect()
    gc.freeze()


class _Run:
    """A player that plays on a thread of its own; `error` is the exception that ended it early."""

    def __init__(self, player: Player, replay: Republisher) -> None:
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


class PlayLine(StatusLine):
    """A line of a terminal: state, time, bar, rate."""

    def show_progress(self, progress: Progress) -> None:
        """Show how far it is."""
        state, rest = state_of(progress), bar_text(progress, width() - 1)
        self._shown = True
        role = "warning" if progress.is_paused else "good"
        self._write(f"{_ERASE_LINE}{paint(state, role)}{rest[len(state) :]}")


def _go_on(
    node: Node, plan: PlayPlan, player: Player, replay: Republisher, run: _Run, line: PlayLine
) -> None:
    """Show how far it is and follow keys, to the end, Ctrl-C, or the service `stop`."""
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


def _what(plan: PlayPlan, player: Player, replay: Republisher) -> str:
    """The recording that is played, in one line."""
    what = [counted(len(replay.streams), "stream"), counted(len(replay.topics), "topic")]
    stamps = "stamps are moved to now" if plan.stamps == "now" else "stamps are those recorded"
    state = ", paused" if plan.is_paused else ""
    rate = f" at rate {plan.rate:g}" if plan.rate != 1.0 else ""
    return (
        f"Playing {duration(player.progress.duration_s)}{rate}{state}: {', '.join(what)}; {stamps}"
    )


KEYS = (
    "space pauses, . plays one message, , the one before, left and right seek 5 s, up and down "
    "change the rate, q ends"
)

_SEEK_S = 5.0

# One press makes it faster by a tenth.
_FASTER = 1.1


def follow(key: str, player: Playhead) -> bool:
    """Follow a key; whether to go on."""
    jobs: dict[str, Callable[[], object]] = {
        " ": player.toggle_paused,
        ".": player.step,
        ",": lambda: player.step(-1),
        "right": lambda: player.seek_by(_SEEK_S),
        "left": lambda: player.seek_by(-_SEEK_S),
        "up": lambda: _change_rate(player, _FASTER),
        "down": lambda: _change_rate(player, 1.0 / _FASTER),
    }
    if key in jobs:
        jobs[key]()
    return key not in ("q", "Q", "\x03")


def _change_rate(player: Playhead, factor: float) -> None:
    player.set_rate(nearest_rate(round(player.progress.rate * factor, 4)))


# The shortest and the longest bar, in characters.
_SHORTEST, _LONGEST = 10, 60

_ERASE_LINE = "\r\x1b[K"

# Who is behind by less is not too slow.
_LATE_NS = 1_000_000_000


def state_of(progress: Progress) -> str:
    """Its state: `playing`."""
    return "paused " if progress.is_paused else "playing"


def bar_text(progress: Progress, columns: int) -> str:
    """The line in at most this many columns: `playing   12.3 / 60.0 s [===>      ] 1x`."""
    all_s = f"{progress.duration_s:.1f}"
    head = f"{state_of(progress)} {progress.played_s:{len(all_s)}.1f} / {all_s} s"
    tail = [f"{progress.rate:g}x"]
    if progress.loops:
        tail.append(f"loop {progress.loops}")
    if progress.late_ns > _LATE_NS:
        tail.append(f"{progress.late_ns / 1e9:.0f} s behind")
    room = columns - len(head) - len("  ".join(tail)) - 4
    if room >= _SHORTEST:
        head += f" {_bar(progress, min(room, _LONGEST))}"
    return cut("  ".join([f"{head} {tail[0]}", *tail[1:]]), columns)


def _bar(progress: Progress, columns: int) -> str:
    part = progress.played_s / progress.duration_s if progress.duration_s > 0.0 else 1.0
    done = round(min(max(part, 0.0), 1.0) * columns)
    head = "=" * (done - 1) + ">" if 0 < done < columns else "=" * done
    return f"[{head:<{columns}}]"


def log_text(progress: Progress) -> str:
    """The line of the log that says every now and then how far it is."""
    state = "Paused at" if progress.is_paused else "At"
    again = f", loop {progress.loops}" if progress.loops else ""
    return (
        f"{state} {progress.played_s:.1f} of {progress.duration_s:.1f} s, "
        f"rate {progress.rate:g}{again}"
    )


def end_text(progress: Progress, running_s: float) -> str:
    """The summary of a replay."""
    text = f"Played {counted(progress.sent, 'message')} in {duration(running_s)}"
    if progress.late_ns > _LATE_NS:
        text += (
            f"; this machine was too slow for rate {progress.rate:g}, by "
            f"{duration(progress.late_ns / 1e9)} in all"
        )
    return text
