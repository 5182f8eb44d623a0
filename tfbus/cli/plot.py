"""`tfbus plot`: the path of a frame over time, as a picture or in a window."""

import os
import sys
import time
from contextlib import suppress
from pathlib import Path

import click

from tfbus.bus.settings import NodeSettings
from tfbus.cli.output import say
from tfbus.command.extras import install_command
from tfbus.command.options import listening_options
from tfbus.command.types import POSITIVE, FrameName, Number, OutputFile, own_name
from tfbus.errors import LookupException, TfbusError
from tfbus.frames.command_listener import Listening, listening
from tfbus.frames.plot import PANELS, Panel, show_plot, write_plot
from tfbus.frames.track import Track, track_from_buffer, track_from_file
from tfbus.runtime.clock import SYSTEM_CLOCK
from tfbus.wire.fleet import Fleet
from tfbus.wording import counted

_ENDINGS = (".png", ".svg", ".pdf")

# How much publishers keep by default.
_KEPT_S = 10.0
_MOST_S = 86_400.0


@click.command(
    epilog="Examples: tfbus plot world turtle1 -o turtle1.png; "
    "tfbus plot world turtle1 --for 30 --show path -o path.svg"
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
    "recording",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    metavar="FILE",
    help="Plot a file written by tfbus echo --format csv (or json).",
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
    "--rate", "rate_hz", type=POSITIVE, default=50.0, show_default=True, help="Poses per second."
)
@listening_options(own_name("_plot"))
def command(
    settings: NodeSettings,
    fleet: Fleet | None,
    target: str | None,
    source: str | None,
    output: Path | None,
    for_s: float | None,
    recording: Path | None,
    panels: tuple[Panel, ...],
    rate_hz: float,
) -> None:
    """Plot position, orientation and speed of SOURCE seen from TARGET."""
    if output is None and not _has_display():
        raise click.UsageError("there is no display for a window: write a file with -o")
    if recording is not None:
        if target is not None or for_s is not None:
            raise click.UsageError("--from plots a file: omit the frames and --for")
        track = track_from_file(recording)
    elif target is None or source is None:
        raise click.UsageError("name two frames: tfbus plot world turtle1")
    else:
        track = _listen(settings, fleet, target, source, for_s, rate_hz)
    if len(track) < 2:
        raise click.ClickException(
            f"{counted(len(track), 'pose')} of {track.source!r} seen from {track.target!r} came in "
            "that time, and a plot needs 2: is it static, or has its publisher stopped?"
        )
    _show(track, output, tuple(dict.fromkeys(panels)))


def _listen(
    settings: NodeSettings,
    fleet: Fleet | None,
    target: str,
    source: str,
    for_s: float | None,
    rate_hz: float,
) -> Track:
    with listening(
        settings, fleet, history_s=_KEPT_S, cache_time_s=max(for_s or 0.0, _KEPT_S) + 5.0
    ) as heard:
        from_ns = heard.node.now_ns()
        if for_s is None:
            from_ns -= int(_KEPT_S * 1e9)
        elif not _wait(heard, for_s):
            say("Interrupted: plotting what has arrived so far")
        # Up to the newest known pose, not to now: later lookups would fail.
        try:
            newest_ns = heard.buffer.latest_common_time(target, source) or heard.node.now_ns()
        except LookupException as error:
            if hint := heard.hint(error.frame):
                raise click.ClickException(f"{error}; {hint}") from error
            raise
        return track_from_buffer(heard.buffer, target, source, from_ns, newest_ns, rate_hz)


def _wait(heard: Listening, for_s: float) -> bool:
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
            if not heard.node.wait(min(left_s, 0.1), clock=SYSTEM_CLOCK):
                break
            now = round((time.monotonic() - start_s) * 10)
            bar.update(now - done)
            done = now
    return heard.node.ok


def _show(track: Track, output: Path | None, panels: tuple[Panel, ...]) -> None:
    try:
        if output is None:
            show_plot(track, panels)
        else:
            write_plot(track, output, panels)
            span_s = track.seconds[-1]
            click.echo(f"Wrote {output}: {counted(len(track), 'pose')} over {span_s:.1f} s")
    except ImportError as error:
        raise TfbusError(
            f"plots need matplotlib, which is not installed: {install_command('plot')}"
        ) from error
    except OSError as error:
        raise TfbusError(f"{output} cannot be written: {error.strerror}") from error


def _has_display() -> bool:
    return sys.platform == "darwin" or bool(
        os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    )
