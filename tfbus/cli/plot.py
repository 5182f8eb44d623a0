"""`tfbus plot`: the path of a frame over time, as a picture or in a window."""

import os
import sys
import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import click

from tfbus.base.errors import LookupException, TfbusError
from tfbus.base.installation import install_command
from tfbus.base.wording import counted
from tfbus.bus.settings import NodeSettings
from tfbus.cli.bus import listening
from tfbus.cli.output import say
from tfbus.command.options import listening_options, max_gap_option
from tfbus.command.recordings import BagChoice, bag_options
from tfbus.command.types import (
    IN_FILE,
    POSITIVE,
    FrameName,
    MomentType,
    Number,
    OutputFile,
)
from tfbus.frames.moment import LiveView
from tfbus.frames.picture import PANELS, Panel, show_plot, write_plot
from tfbus.frames.track import track_from_buffer
from tfbus.geometry.sampling import Sampling
from tfbus.geometry.trajectory import Trajectory, read_echo
from tfbus.wire.fleet import Fleet

V = TypeVar("V")

_ENDINGS = (".png", ".svg", ".pdf")
_RATE_HZ = 50.0

# How much publishers keep by default.
_KEPT_S = 10.0
_MOST_S = 86_400.0


@click.command(
    epilog="Examples: tfbus plot world turtle1 -o turtle1.png; "
    "tfbus plot world turtle1 --for 30 --show path -o path.svg; "
    "tfbus plot world turtle1 --bag run.mcap --from +10s --to +20s -o part.png"
)
@click.argument("target", type=FrameName(), required=False)
@click.argument("source", type=FrameName(), required=False)
@click.option(
    "-o",
    "--output",
    type=OutputFile(*_ENDINGS),
    metavar="FILE",
    help=f"Write a picture ({' '.join(_ENDINGS)}) instead of opening a window.",
)
@click.option(
    "--for",
    "for_s",
    type=Number(least=0.0, most=_MOST_S, more_than_least=True),
    metavar="SECONDS",
    help="Listen for this long; by default, plot the last 10 s, which publishers keep.",
)
@click.option(
    "--from",
    "from_text",
    metavar="FILE|TIME",
    help="Plot a file written by tfbus echo --format csv (or json); with --bag, begin then.",
)
@click.option(
    "--show",
    "panels",
    type=click.Choice(PANELS),
    multiple=True,
    default=PANELS,
    help="What to plot; repeatable (default all).",
)
@click.option(
    "--rate",
    "rate_hz",
    type=POSITIVE,
    help="Poses per second (default 50; with --bag one for each sample).",
)
@bag_options("end", statics=True)
@max_gap_option
@listening_options("_plot")
def command(
    settings: NodeSettings,
    fleet: Fleet | None,
    bag: BagChoice | None,
    target: str | None,
    source: str | None,
    output: Path | None,
    for_s: float | None,
    from_text: str | None,
    panels: tuple[Panel, ...],
    rate_hz: float | None,
    sampling: Sampling,
) -> None:
    """Plot position, orientation and speed of SOURCE seen from TARGET."""
    if output is None and not _has_display():
        raise click.UsageError("there is no display for a window: write a file with -o")
    if from_text is not None and bag is None:
        is_of_file_alone = (target, for_s, rate_hz, sampling) == (None, None, None, Sampling())
        if not is_of_file_alone:
            raise click.UsageError(
                "--from plots all poses of a file: omit the frames, --for, --rate and --max-gap, "
                "or give --bag"
            )
        track = read_echo(_of_option("--from", IN_FILE, from_text))
    elif target is None or source is None:
        raise click.UsageError("name two frames: tfbus plot world turtle1")
    elif bag is not None:
        if for_s is not None:
            raise click.UsageError("--for listens to a bus; of a recording, give --from and --to")
        begin = None if from_text is None else _of_option("--from", MomentType(), from_text)
        track = _read(settings, fleet, replace(bag, begin=begin), target, source, rate_hz, sampling)
    else:
        track = _listen(settings, fleet, target, source, for_s, rate_hz or _RATE_HZ, sampling)
    if len(track) < 2:
        raise click.ClickException(
            f"{counted(len(track), 'pose')} of {track.child_frame_id!r} seen from "
            f"{track.frame_id!r} came in that time, and a plot needs 2: is it static, or has its "
            "publisher stopped?"
        )
    _show(track, output, tuple(dict.fromkeys(panels)))


def _of_option(name: str, type_: click.ParamType[V], text: str) -> V:
    """The text of an option as a type that others of its options decide. Raises click.BadParameter,
    which names the option.
    """
    context = click.get_current_context()
    option = next(each for each in context.command.params if name in each.opts)
    value: V = type_.convert(text, option, context)
    return value


def _read(
    settings: NodeSettings,
    fleet: Fleet | None,
    bag: BagChoice,
    target: str,
    source: str,
    rate_hz: float | None,
    sampling: Sampling,
) -> Trajectory:
    from tfbus.frames.recorded_poses import recorded_track

    return recorded_track(bag, settings, fleet, target, source, rate_hz, sampling)


def _listen(
    settings: NodeSettings,
    fleet: Fleet | None,
    target: str,
    source: str,
    for_s: float | None,
    rate_hz: float,
    sampling: Sampling,
) -> Trajectory:
    with listening(
        settings,
        fleet,
        history_s=_KEPT_S,
        cache_time_s=max(for_s or 0.0, _KEPT_S) + 5.0,
        sampling=sampling,
    ) as heard:
        from_ns = heard.now_ns()
        if for_s is None:
            from_ns -= int(_KEPT_S * 1e9)
        elif not _wait(heard, for_s):
            say("Interrupted: plotting what has arrived so far")
        # Up to the newest known pose, not to now: later lookups would fail.
        try:
            newest_ns = heard.buffer.latest_common_time(target, source) or heard.now_ns()
        except LookupException as error:
            if hint := heard.hint(error.frame):
                raise click.ClickException(f"{error}; {hint}") from error
            raise
        return track_from_buffer(heard.buffer, target, source, from_ns, newest_ns, rate_hz)


def _wait(heard: LiveView, for_s: float) -> bool:
    """Listen with a progress bar; False if Ctrl-C ends it early."""
    start_s = time.monotonic()
    with (
        suppress(KeyboardInterrupt),
        click.progressbar(
            length=round(for_s * 10), label="Listening", file=sys.stderr, width=40
        ) as bar,
    ):
        done = 0
        while (left_s := start_s + for_s - time.monotonic()) > 0:
            if not heard.wait(min(left_s, 0.1)):
                return False
            now = round((time.monotonic() - start_s) * 10)
            bar.update(now - done)
            done = now
        return True
    return False


def _show(track: Trajectory, output: Path | None, panels: tuple[Panel, ...]) -> None:
    try:
        if output is None:
            show_plot(track, panels)
        else:
            write_plot(track, output, panels)
    except ImportError as error:
        raise TfbusError(
            f"plots need matplotlib, which is not installed: {install_command('plot')}"
        ) from error
    except OSError as error:
        raise TfbusError(f"{output} cannot be written: {error.strerror}") from error
    if output is not None:
        click.echo(f"Wrote {output}: {counted(len(track), 'pose')} over {track.span_s:.1f} s")


def _has_display() -> bool:
    return sys.platform == "darwin" or bool(
        os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    )
