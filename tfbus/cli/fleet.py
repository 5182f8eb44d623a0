"""`tfbus fleet`: a fleet at a glance, one line a robot."""

import shutil
from collections import Counter
from collections.abc import Iterable, Sequence
from contextlib import ExitStack, suppress
from dataclasses import asdict

import click

from tfbus.base.clock import SYSTEM_CLOCK
from tfbus.base.wording import counted, duration, listed, offset
from tfbus.bus.settings import NodeSettings
from tfbus.cli.bus import frames_at, is_running, listening, moment_lines, warn_if_starved
from tfbus.cli.output import (
    first_lines,
    is_terminal,
    json_option,
    paint,
    print_json,
    print_lines,
    run_in_shell,
    screen,
    table,
)
from tfbus.command.options import (
    check_grace,
    grace_option,
    listening_options,
    period_option,
    roster_option,
)
from tfbus.command.recordings import BagChoice, bag_options
from tfbus.frames.fleet import FleetWatch, RobotStatus
from tfbus.frames.moment import BusMoment, LiveView
from tfbus.wire.fleet import Fleet

# A watch looks at all frames as often as takes this share of the time, and at least so often; at
# the robots' streams and nodes for each page.
_MOST_FOR_FRAMES, _FRAMES_EVERY_S = 0.05, 10.0

# The lines of a page that is no terminal's, and its lines besides robots.
_LINES, _BESIDE_ROBOTS = 24, 4

# Tools that list frames show robots instead, if a pipe would get more frames than this.
_MOST_IN_PIPE = 200


@click.command(
    epilog="Examples: tfbus fleet; tfbus fleet --expect 'robot[1-30]' --watch; "
    "tfbus fleet --expect robots.txt --watch --on-gone 'notify-send $TFBUS_ROBOT' "
    "--on-back 'notify-send back: $TFBUS_ROBOT'"
)
@roster_option
@click.option("--all", "show_all", is_flag=True, help="Show each robot, also those that are well.")
@click.option("-w", "--watch", is_flag=True, help="Refresh it in place until Ctrl-C.")
@click.option(
    "--on-gone",
    metavar="COMMAND",
    help="With --watch: run this in a shell for each robot that is gone or missing, with "
    "TFBUS_ROBOT and TFBUS_STATE (gone, missing) in its environment.",
)
@click.option(
    "--on-back",
    metavar="COMMAND",
    help="With --watch: run this for each of these robots that is back, with TFBUS_STATE=there.",
)
@grace_option("--on-gone runs for the missing")
@period_option("How long rates are measured, and the time between pages")
@json_option("Print one JSON object; with --watch a line for each change of a robot's state.")
@bag_options("at")
@listening_options("_fleet", always_fleet=True)
def command(
    settings: NodeSettings,
    fleet: Fleet,
    bag: BagChoice | None,
    roster: tuple[str, ...],
    show_all: bool,
    watch: bool,
    on_gone: str | None,
    on_back: str | None,
    grace_s: float,
    period_s: float,
    as_json: bool,
) -> None:
    """Show a fleet at a glance: which robots are there, gone, missing or in trouble.

    A robot is a namespace, as of nodes that run with --namespace robot7. The worst come first, and
    robots without a problem are counted if a screen has no room for them. With --expect it exits
    with 1 if one of these is gone or missing.
    """
    if (on_gone or on_back) and not watch:
        raise click.UsageError("--on-gone and --on-back are for --watch")
    check_grace((on_gone or on_back) and roster, "--expect with --on-gone or --on-back")
    if watch and bag is not None:
        raise click.UsageError("--watch shows a bus; a moment of a recording does not change")
    robots = watch_of(fleet, roster)
    if bag is not None:
        with frames_at(bag, settings, fleet) as frames:
            moment = frames.moment()
            if not as_json:
                print_lines(moment_lines(bag, frames))
        _show(robots.robots(moment), moment, show_all, as_json, bool(roster))
        return
    with listening(settings, fleet, goes_on=watch, history_s=0.0) as heard:
        heard.watch_nodes()
        if watch:
            with suppress(KeyboardInterrupt):  # its usual end
                lost = _Lost(on_gone, on_back, grace_s)
                _watch(heard, robots, period_s, show_all, lost, as_json)
            return
        robots.robots(heard.moment())
        if not heard.wait(period_s):
            raise KeyboardInterrupt
        moment = heard.moment()
        found = robots.robots(moment)
        if any(each.state != "there" for each in found) and heard.catch_up():
            moment = heard.moment()
            found = robots.robots(moment)
        warn_if_starved([each.name for each in found if each.state != "there"])
        _show(found, moment, show_all, as_json, bool(roster))


def _show(
    robots: Sequence[RobotStatus],
    moment: BusMoment,
    show_all: bool,
    as_json: bool,
    has_roster: bool,
) -> None:
    """Print the fleet once; exits with 1 if a robot of the roster is not there."""
    if as_json:
        print_json({"at_ns": moment.at_ns, "robots": list(map(asdict, robots))})
    elif robots:
        print_lines(as_lines(robots, moment.at_ns, None if show_all else _height()))
    if not robots:
        raise click.ClickException(_no_robot(moment))
    if has_roster and any(each.is_expected and each.state != "there" for each in robots):
        raise SystemExit(1)


def _no_robot(moment: BusMoment) -> str:
    """The sentence if there is none; nodes in no namespace below are none. Tools, whose names begin
    with `_`, are not named.
    """
    why = is_running("node")
    nodes = (name for name in moment.node_names if not name.rpartition("/")[2].startswith("_"))
    if names := sorted(nodes):
        why = f"{listed(names, most=2)} {'is' if len(names) == 1 else 'are'} in none"
    return f"no robot in a namespace below: {why} (tfbus NODE --namespace robot7)"


def _watch(
    heard: LiveView,
    watch: FleetWatch,
    period_s: float,
    show_all: bool,
    lost: "_Lost",
    as_json: bool,
) -> None:
    frames_due_s, states = SYSTEM_CLOCK.elapsed_ns() / 1e9, dict[str, str]()
    with suppress(KeyboardInterrupt), ExitStack() as stack:
        show = None if as_json else stack.enter_context(screen())
        while True:
            began_s = SYSTEM_CLOCK.elapsed_ns() / 1e9
            has_frames = began_s >= frames_due_s
            moment = heard.moment(has_frames=has_frames)
            robots = watch.robots(moment, has_frames=has_frames)
            if has_frames:
                took_s = SYSTEM_CLOCK.elapsed_ns() / 1e9 - began_s
                frames_due_s = began_s + min(took_s / _MOST_FOR_FRAMES, _FRAMES_EVERY_S)
            unlinked = heard.unlinked()
            news = [each for each in robots if states.get(each.name) != each.state]
            states = {each.name: each.state for each in robots}
            if show is None:
                for robot in news:
                    print_json({"at_ns": moment.at_ns} | asdict(robot))
            else:
                lines = as_lines(robots, moment.at_ns, None if show_all else _height())
                lines = lines if robots else [f"Waiting: {_no_robot(moment)}"]
                if unlinked:
                    lines = [paint(f"No link to {unlinked}: robots cannot be seen", "bad"), *lines]
                show(lines)
            lost.update(robots, is_cut=bool(unlinked))
            if not heard.wait(period_s):
                return


class _Lost:
    """The robots that are gone or missing, and the commands that run when one is, and when it is
    back. A robot that never came may be booting, and one that left within `grace_s` seconds of a
    loss or return of this process's own link may be there. These count once they were away for so
    long while that link was lost, or for so long while it was not, however often it comes and goes.
    """

    def __init__(self, on_gone: str | None, on_back: str | None, grace_s: float) -> None:
        self._on_gone, self._on_back = on_gone, on_back
        self._grace_s = grace_s
        self._updated_s = self._changed_s = SYSTEM_CLOCK.elapsed_ns() / 1e9
        self._was_cut = self._has_changed = False
        self._names: set[str] = set()
        # How long each robot with a grace was away without the own link, and with it.
        self._away_s: dict[str, dict[bool, float]] = {}

    def update(self, robots: Iterable[RobotStatus], *, is_cut: bool) -> None:
        """Run the commands for the robots that are lost or back now; `is_cut` is whether this
        process has lost its own link.
        """
        now_s = SYSTEM_CLOCK.elapsed_ns() / 1e9
        passed_s, self._updated_s = now_s - self._updated_s, now_s
        if is_cut != self._was_cut:
            self._was_cut, self._has_changed, self._changed_s = is_cut, True, now_s
        is_excuse = self._has_changed and now_s - self._changed_s < self._grace_s
        before, self._names = self._names, set()
        former, self._away_s = self._away_s, {}
        for robot in robots:
            name = robot.name
            if robot.state == "there":
                if name in before:
                    _run_for(robot, "--on-back", self._on_back)
                continue
            if name not in before and (name in former or robot.state == "missing" or is_excuse):
                away_s = former.get(name)
                if away_s is None:  # it may have left just now
                    away_s = {True: 0.0, False: 0.0}
                else:
                    away_s[is_cut] += passed_s
                if max(away_s.values()) < self._grace_s:
                    self._away_s[name] = away_s
                    continue
            self._names.add(name)
            if name not in before:
                _run_for(robot, "--on-gone", self._on_gone)


def _run_for(robot: RobotStatus, option: str, line: str | None) -> None:
    if line:
        run_in_shell(option, line, {"TFBUS_ROBOT": robot.name, "TFBUS_STATE": robot.state})


def _height() -> int:
    """How many lines a page may have."""
    return shutil.get_terminal_size((80, _LINES)).lines if is_terminal() else _LINES


def as_lines(robots: Sequence[RobotStatus], at_ns: int, height: int | None = None) -> list[str]:
    """A line of sums, and a table of the robots, worst first, in at most `height` lines: robots
    without a problem are counted if there is no room for them.
    """
    shown = list(robots)
    if height is not None and len(robots) > height - _BESIDE_ROBOTS:
        shown = [each for each in robots if not each.is_well]
    well = len(robots) - len(shown)
    rows = [_row(each, at_ns) for each in shown]
    headings = ("robot", "state", "age", "clock", "Hz", "kB/s", "version", "problems")
    lines = table(headings, rows, right=(2, 3, 4, 5), names=(0,)) if rows else []
    if height is not None:
        lines = first_lines(lines, max(height - _BESIDE_ROBOTS, 1))
    if well:
        lines.append(f"{counted(well, 'robot')} without a problem (--all shows each)")
    return [_sums(robots), *lines]


class FleetPage:
    """The page of a tool with --fleet that lists frames, once these do not fit: a line a robot."""

    def __init__(self, fleet: Fleet | None) -> None:
        self._robots = None if fleet is None else watch_of(fleet)

    def lines(self, moment: BusMoment, all_by: str) -> list[str] | None:
        """The robots at a moment, and the option `all_by` by which all frames are seen; None if the
        frames fit on a screen (in a pipe, on 200 lines), or are of one robot.
        """
        if self._robots is None:
            return None
        robots = self._robots.robots(moment)
        room = _height() if is_terminal() else _MOST_IN_PIPE
        if len(robots) < 2 or len(moment.frames) < room:
            return None
        count = counted(len(moment.frames), "frame")
        return [*as_lines(robots, moment.at_ns, _height() - 1), f"{count}: {all_by}"]


def watch_of(fleet: Fleet, roster: Iterable[str] = ()) -> FleetWatch:
    """A watch of a fleet with these shared frames."""
    return FleetWatch(roster, shares_frames=bool(fleet.shared_frames))


def _sums(robots: Sequence[RobotStatus]) -> str:
    expected = [each for each in robots if each.is_expected]
    count = Counter(each.state for each in expected)
    troubled = sum(each.state == "there" and not each.is_well for each in expected)
    parts = [f"{count['there']:,} of {counted(len(expected), 'robot')} there"]
    parts += [
        paint(f"{count[state]:,} {state}", "bad") for state in ("gone", "missing") if count[state]
    ]
    if troubled:
        parts.append(paint(f"{troubled:,} with problems", "warning"))
    if others := len(robots) - len(expected):
        parts.append(paint(f"{others:,} not expected", "warning"))
    return ", ".join(parts)


def _row(robot: RobotStatus, at_ns: int) -> tuple[str, ...]:
    clock = robot.clock_offset_s
    role = "" if robot.is_well else "warning" if robot.state == "there" else "bad"
    return (
        paint(robot.name, "name"),
        paint(robot.state_text(at_ns), role) if role else robot.state,
        "" if robot.age_s is None else duration(robot.age_s),
        "" if clock is None else offset(clock),
        "" if robot.messages_hz is None else f"{robot.messages_hz:.1f}",
        "" if robot.bytes_per_s is None else f"{robot.bytes_per_s / 1e3:.1f}",
        listed(robot.versions, most=2),
        robot.trouble,
    )
