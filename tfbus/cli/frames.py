"""`tfbus frames`: the tree of frames in the terminal, as a picture, or as JSON."""

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import click

from tfbus.base.errors import TfbusError
from tfbus.base.installation import install_command
from tfbus.base.json_text import json_text
from tfbus.base.whole_file import replacing
from tfbus.base.wording import counted
from tfbus.bus.settings import NodeSettings
from tfbus.cli.bus import (
    frames_at,
    is_running,
    listening,
    moment_lines,
    warn_if_starved,
    warn_of_unanswered,
)
from tfbus.cli.fleet import FleetPage
from tfbus.cli.output import json_option, longest_line, paint_state, print_lines, screen, width
from tfbus.command.options import listening_options
from tfbus.command.recordings import BagChoice, bag_options
from tfbus.command.types import Number, OutputFile
from tfbus.frames import document
from tfbus.frames.document import edge_lines, tree_lines
from tfbus.frames.moment import BusMoment, LiveView
from tfbus.frames.picture import write_picture
from tfbus.frames.snapshot import FrameTree
from tfbus.wire.fleet import Fleet

_TEXTS: dict[str, Callable[[FrameTree], str]] = {
    ".dot": document.as_tf2_dot,
    ".gv": document.as_tf2_dot,
    ".json": document.as_json,
    ".yaml": document.as_tf2_yaml,
    ".mmd": document.as_mermaid,
    ".txt": document.as_text,
}
_PICTURES = (".svg", ".pdf", ".png")
_ENDINGS = [*_PICTURES, *_TEXTS]


@click.command(
    epilog="Examples: tfbus frames; tfbus frames -o frames.svg; tfbus frames --watch; "
    "tfbus frames --bag run.mcap --at -3s"
)
@click.option(
    "-o",
    "--output",
    "outputs",
    multiple=True,
    type=OutputFile(*_ENDINGS),
    metavar="FILE",
    help=f"Write a file; its extension sets the format: {' '.join(_ENDINGS)}; repeatable.",
)
@click.option("-w", "--watch", is_flag=True, help="Refresh it in place every 0.5 s, until Ctrl-C.")
@click.option("-l", "--long", is_flag=True, help="Print all facts of each edge.")
@json_option("Print one JSON object.")
@click.option(
    "-t",
    "--wait-time",
    "wait_s",
    type=Number(least=0.0, most=3600.0),
    default=2.0,
    metavar="SECONDS",
    show_default=True,
    help="Listen for at most this long; stop once every stream is complete.",
)
@click.option("--check", is_flag=True, help="Exit with 1 if something is wrong with the tree.")
@bag_options("at")
@listening_options("_frames")
def command(
    settings: NodeSettings,
    fleet: Fleet | None,
    bag: BagChoice | None,
    outputs: tuple[Path, ...],
    watch: bool,
    long: bool,
    as_json: bool,
    wait_s: float,
    check: bool,
) -> None:
    """Show the tree of frames, its publishers, and what is wrong with it."""
    if watch and (outputs or as_json):
        raise click.UsageError("--watch shows the tree in the terminal: omit -o and --json")
    if bag is not None:
        if watch:
            raise click.UsageError("--watch shows a bus; a moment of a recording does not change")
        _show_recorded(settings, fleet, bag, outputs, long=long, as_json=as_json, check=check)
        return
    with listening(settings, fleet, within_s=wait_s, goes_on=watch) as heard:
        if watch:
            with suppress(KeyboardInterrupt):  # its usual end
                _watch(heard, FleetPage(fleet), long)
            return
        if any(frame.gone for frame in heard.tree().frames.values()):
            heard.catch_up()
        heard.ask_nodes()
        moment = heard.moment()
        tree = moment.tree
        hint = "" if tree.frames else heard.hint()
    _show(moment, FleetPage(fleet), outputs, long=long, as_json=as_json)
    warn_of_unanswered(moment.unanswered)
    warn_if_starved([frame.name for frame in tree.frames.values() if frame.gone])
    if not tree.frames:
        silent = next((each.text for each in tree.problems() if each.kind == "silent"), "")
        why = hint or silent or is_running("broadcaster")
        raise click.ClickException(f"no frame after {wait_s:g} s: {why}")
    if check and tree.problems():
        raise SystemExit(1)


def _show_recorded(
    settings: NodeSettings,
    fleet: Fleet | None,
    bag: BagChoice,
    outputs: tuple[Path, ...],
    *,
    long: bool,
    as_json: bool,
    check: bool,
) -> None:
    with frames_at(bag, settings, fleet) as heard:
        tree = heard.tree()
        if not tree.frames:
            hint = heard.hint()
            raise click.ClickException(
                f"no frame in the recording {'by then' if bag.at else 'at all'}"
                f"{f': {hint}' if hint else ''}"
            )
        if not as_json and not outputs:
            print_lines(moment_lines(bag, heard))
        _show(heard.moment(), FleetPage(fleet), outputs, long=long, as_json=as_json)
    if check and tree.problems():
        raise SystemExit(1)


def _show(
    moment: BusMoment,
    page: FleetPage,
    outputs: tuple[Path, ...],
    *,
    long: bool,
    as_json: bool,
) -> None:
    tree = moment.tree
    if as_json:
        told = document.as_map(tree) | {"unanswered": list(moment.unanswered)}
        click.echo(json_text(told, indent=2))
    elif tree.frames and not outputs:
        print_lines(_lines(moment, page, long))
    for path in outputs:
        _write(tree, path)
        click.echo(f"Wrote {path}: {counted(len(tree.frames), 'frame')}", err=as_json)


def _lines(moment: BusMoment, page: FleetPage, long: bool) -> list[str]:
    tree = moment.tree
    if not long and (robots := page.lines(moment, "--long shows each, -o FILE writes them")):
        return robots
    if long:
        return [*edge_lines(tree), *document.summary(tree, [], width=width())]
    shown = tree_lines(tree, width=longest_line(), paint=paint_state)
    return document.summary(tree, shown, width=width())


def _nothing(heard: LiveView) -> list[str]:
    hint = heard.hint_while_empty()
    return [f"No frame yet: {hint}" if hint else "No frame yet"]


def _watch(heard: LiveView, page: FleetPage, long: bool) -> None:
    heard.watch_nodes()
    with screen() as show:
        while True:
            moment = heard.moment()
            show(_lines(moment, page, long) if moment.tree.frames else _nothing(heard))
            if not heard.wait(0.5):
                return


def _write(tree: FrameTree, path: Path) -> None:
    try:
        if path.suffix in _PICTURES:
            write_picture(tree, path)
        else:
            text = _TEXTS[path.suffix](tree)
            with replacing(path) as file:
                file.write(text.encode())
    except ImportError as error:
        raise TfbusError(
            f"{path.name} needs matplotlib, which is not installed: "
            f"{install_command('plot')}, or write .dot, .mmd, .json, .yaml or .txt"
        ) from error
    except OSError as error:
        raise TfbusError(f"{path} cannot be written: {error.strerror}") from error
