"""`tfbus view`: all frames in three dimensions, on a page for browsers (RViz's TF display).

Try it: tfbus launch turtle view:=true
"""

import shlex
import signal
import socket
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from tfbus import (
    Buffer,
    Fleet,
    Node,
    NodeSettings,
    Number,
    RightsError,
    Robot,
    SettingsError,
    TfbusError,
    TransformListener,
    fleet_options,
    node_options,
)
from tfbus.base.installation import install_command
from tfbus.command.options import roster_option
from tfbus.command.recordings import BagChoice, bag_options
from tfbus.command.server import ServerOptions, server_options
from tfbus.command.types import OutputFile, own_name
from tfbus.frames.command_listener import Listening as Bus
from tfbus.view.settings import ViewSettings, holds_settings, load_settings, topic_named

if TYPE_CHECKING:
    from tfbus import Fleet
    from tfbus.view.page import Page, Serving
    from tfbus.view.robots import RobotSource
    from tfbus.view.scene.drawn import Guest
    from tfbus.view.screenshot import Screenshot

_NAME = "view"


def _size(ctx: click.Context, param: click.Parameter, text: str) -> tuple[int, int]:
    width, _, height = text.partition("x")
    if not (width.isdecimal() and height.isdecimal()):
        raise click.BadParameter(f"{text!r} is not a size like 1280x800")
    if not all(100 <= int(side) <= 8000 for side in (width, height)):
        raise click.BadParameter(f"{text!r}: width and height must be from 100 to 8000 pixels")
    return int(width), int(height)


@click.command(epilog="Example: tfbus view --port 8080")
@server_options("view", 8080)
@click.option(
    "--read-only/--operate",
    "read_only",
    default=None,
    help="Whether browsers only look, or may drive turtles, move joints and save settings "
    "(default: operate, with --public read-only).",
)
@click.option(
    "--history",
    "history_s",
    type=Number(least=1.0, most=3600.0),
    default=30.0,
    help="How many seconds the page can go back (default 30).",
)
@click.option(
    "--rate",
    "rate_hz",
    type=Number(least=1.0, most=60.0),
    default=30.0,
    help="Updates per second (default 30).",
)
@click.option(
    "--settings",
    "path",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="FILE",
    help="Load the page's settings from here, and save them here (default view.yaml).",
)
@click.option(
    "--urdf",
    type=click.Path(path_type=Path, dir_okay=False, exists=True),
    metavar="FILE",
    help="Show this robot, of a URDF or .xacro file (default: those described on the bus).",
)
@click.option(
    "--package-path",
    "package_path",
    type=click.Path(path_type=Path, file_okay=False, exists=True),
    multiple=True,
    metavar="DIR",
    help="A folder with meshes of the URDF and of markers, in packages or by file://; repeatable.",
)
@click.option(
    "--mesh-up-axis",
    "heeds_up_axis",
    type=click.Choice(("ignore", "file")),
    default="ignore",
    callback=lambda context, option, value: value == "file",
    help="Turn DAE meshes by the up axis that the file states, or do not, as RViz (default).",
)
@click.option(
    "--screenshot",
    type=OutputFile(".png"),
    metavar="FILE",
    help="Save a picture of the page, such as out.png, and exit.",
)
@click.option(
    "--after",
    "after_s",
    type=Number(least=0.0, most=3600.0),
    default=3.0,
    help="Take the picture after this many seconds (default 3).",
)
@click.option(
    "--size",
    default="1280x800",
    callback=_size,
    metavar="WxH",
    help="The picture's width and height in pixels (default 1280x800).",
)
@click.option(
    "--topic",
    "topics",
    multiple=True,
    metavar="NAME[:SETTINGS]",
    help="Draw the messages of this topic from the start, such as scan, with settings of its own, "
    "such as points:voxel=5,rate_hz=5 (voxel and size are in cm); repeatable.",
)
@click.option(
    "--follow",
    metavar="FRAME",
    help="Let the camera move along with this frame, such as base_link.",
)
@bag_options("at", "begin", "end")
@roster_option
@fleet_options
@node_options(_NAME)
def main(
    settings: NodeSettings,
    fleet: "Fleet | None",
    roster: tuple[str, ...],
    bag: BagChoice | None,
    listening: ServerOptions,
    read_only: bool | None,
    history_s: float,
    rate_hz: float,
    path: Path | None,
    urdf: Path | None,
    package_path: tuple[Path, ...],
    heeds_up_axis: bool,
    screenshot: Path | None,
    after_s: float,
    size: tuple[int, int],
    topics: tuple[str, ...],
    follow: str | None,
) -> None:
    """Show all frames in a browser, of the bus or with --bag of a recording."""
    if settings.config and holds_settings(Path(settings.config)):
        raise click.UsageError(
            f"{settings.config} has the view's settings, and --config is for Zenoh's: use "
            f"tfbus view --settings {shlex.quote(settings.config)}"
        )
    robot = Robot.from_urdf(urdf, package_path=package_path) if urdf else None
    is_new = path is not None and not path.exists()
    chosen = load_settings(path) if path and not is_new else ViewSettings()
    if follow is not None:
        chosen = replace(chosen, follow=follow)
    names = []
    for text in topics:
        try:
            shown = topic_named(text, chosen, settings.namespace)
        except SettingsError as error:
            raise click.BadParameter(str(error), param_hint="'--topic'") from None
        names.append(shown.topic)
        others = tuple(each for each in chosen.topics if each.topic != shown.topic)
        chosen = replace(chosen, topics=(*others, shown))
    if screenshot and listening.is_public:
        raise click.UsageError("--screenshot and --public are mutually exclusive: give one")
    _require_viser()
    # The libraries of the page, and the looks of a recording, take seconds.
    click.echo(f"Loading the page{f' for {screenshot}' if screenshot else ''} ...", err=True)
    from tfbus.view.data.topics import DataOnBus, ToolPublishers
    from tfbus.view.page import Page, Serving
    from tfbus.view.robots import RobotsOnBus
    from tfbus.view.screenshot import Screenshot, find_browser
    from tfbus.view.server import Access

    # Of several tabs, each names its robot.
    title = " · ".join(filter(None, ("tfbus", settings.namespace, socket.gethostname())))
    public = listening.public(settings)
    serving = Serving(
        listening.host,
        listening.port,
        rate_hz,
        history_s,
        chosen,
        path or Path("view.yaml"),
        title,
        Access(public.token, public.tls) if public else None,
        read_only=listening.is_public if read_only is None else read_only,
        heeds_up_axis=heeds_up_axis,
        roster=roster,
        package_path=package_path,
    )
    notes = public.notes if public else ()
    shot = Screenshot(screenshot, after_s, size, find_browser()) if screenshot else None
    if bag is not None:
        _show_recording(settings, bag, fleet, serving, robot, package_path, shot, notes, names)
        if shot:
            _finish(shot)
            click.echo(f"Wrote {screenshot}")
        return
    if shot and settings.name == _NAME:
        # Beside a page that is open it is another one.
        settings = replace(settings, name=own_name(_NAME))
    with _join(settings) as node:
        buffer = Buffer(history_s)
        with TransformListener(buffer, node, fleet=fleet) as listener:
            robots = RobotsOnBus(node, fleet, package_path, robot)
            bus = Bus(node, buffer, listener, fleet)
            data = DataOnBus(node, fleet)
            tools = None if serving.read_only else ToolPublishers(node)
            page = Page(node, bus, serving, robots, _guests(node), data=data, tools=tools)
            try:
                if shot:
                    shot.begin(page.address, page.hold, node.shutdown)
                if page.port != serving.port:
                    node.log.warning("%s", _taken(page, serving))
                node.ready(_opened(page))
                for note in notes:
                    node.log.info("%s", note)
                if is_new and not serving.read_only:
                    node.log.info("%s does not exist yet: Save settings writes it", path)
                page.run()
            finally:
                if shot:
                    shot.stop()
            if shot and page.data is not None:
                page.data.warn_of(names)
            page.close()
    if shot:
        _finish(shot)
        click.echo(f"Wrote {screenshot}")


def _show_recording(
    settings: NodeSettings,
    bag: BagChoice,
    fleet: "Fleet | None",
    serving: "Serving",
    robot: Robot | None,
    package_path: Sequence[Path],
    shot: "Screenshot | None",
    notes: Sequence[str],
    topics: Sequence[str],
) -> None:
    """The page for a recording; no bus is opened. It plays once a browser is there, unless a moment
    is given, or a picture wanted.
    """
    from tfbus.view.page import Page
    from tfbus.view.replay import RecordedData, Replay
    from tfbus.view.robots import GivenRobots, RecordedRobots, ShownRobot

    with bag.opened() as opened:
        start_ns, end_ns = opened.span
        is_still = bag.at is not None or shot is not None
        at_ns = (opened.at_ns if bag.at is not None else end_ns) if is_still else start_ns
        replay = Replay(
            opened.reader,
            at_ns=at_ns,
            plays=not is_still,
            start_ns=start_ns,
            end_ns=end_ns,
            namespace=settings.namespace,
            fleet=fleet,
        )
        robots: "RobotSource"
        if robot is not None:
            robots = GivenRobots([ShownRobot(robot)])
        else:
            robots = RecordedRobots(opened.reader, replay, package_path)
        with replay.until_signal():
            page = Page(replay, replay, serving, robots, replay=replay, data=RecordedData(replay))
            try:
                if shot:
                    replay.measure()
                    shot.begin(page.address, page.hold, replay.end)
                else:
                    replay.measure_meanwhile()
                if page.port != serving.port:
                    click.echo(_taken(page, serving), err=True)
                click.echo(_opened(page), err=True)
                for note in notes:
                    click.echo(note, err=True)
                page.run()
            finally:
                if shot:
                    shot.stop()
                page.close()
            if shot and page.data is not None:
                page.data.warn_of(topics)


def _opened(page: "Page") -> str:
    return f"View: {' or '.join(page.addresses)}"


def _taken(page: "Page", serving: "Serving") -> str:
    return f"Port {serving.port} of {serving.host} is taken: using {page.port}"


def _guests(node: Node) -> "Sequence[Guest]":
    """Further contents of the page: the turtles, if this identity may ask for their field."""
    from .turtle.view.guest import TurtleGuest

    try:
        node.settings.check_right("calls", "field")
    except RightsError:
        return ()
    return (TurtleGuest(node),)


def _finish(shot: "Screenshot") -> None:
    """End the picture's browser; without a picture, with the exit code of Ctrl-C."""
    try:
        shot.finish()
    except KeyboardInterrupt:
        raise SystemExit(128 + signal.SIGINT) from None


def _join(settings: NodeSettings) -> Node:
    """The view's node. Raises SettingsError; for a YAML file it points to --settings."""
    try:
        return Node.from_settings(settings)
    except SettingsError as error:
        if Path(settings.config).suffix not in (".yaml", ".yml"):
            raise
        raise SettingsError(
            f"{error}; the view's own settings go to --settings {settings.config}"
        ) from error


def _require_viser() -> None:
    try:
        import viser  # noqa: F401  # only whether it is installed
    except ImportError as error:
        raise TfbusError(f"viser is not installed ({error}): {install_command('view')}") from error


if __name__ == "__main__":
    main()
