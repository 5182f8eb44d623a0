"""The tab of a fleet: one line a robot, as `tfbus fleet` has it."""

from html import escape

import viser

from tfbus.frames.clocks import MOST_SKEW_S
from tfbus.frames.fleet import FleetWatch, RobotStatus
from tfbus.frames.moment import BusMoment
from tfbus.view.panels.markup import Html
from tfbus.wording import and_more, counted, duration

# More rows are slow to show; the worst come first.
_MOST_ROWS = 150

_EVERY_NS = 1_000_000_000


class FleetTab:
    """A tab that is there once two robots have been, or are expected."""

    title = "Fleet"

    def __init__(
        self, gui: viser.GuiApi, tabs: viser.GuiTabGroupHandle, roster: tuple[str, ...] = ()
    ) -> None:
        self._gui = gui
        self._tabs = tabs
        self._watch = FleetWatch(roster)
        self._page: Html | None = None
        self._at_ns: int | None = None

    def refresh(self, moment: BusMoment) -> None:
        """Show the robots of this moment; at most once a second."""
        if self._at_ns is not None and abs(moment.at_ns - self._at_ns) < _EVERY_NS:
            return
        self._at_ns = moment.at_ns
        robots = self._watch.robots(moment)
        if self._page is None:
            if len(robots) < 2:
                return
            with self._tabs.add_tab(self.title):
                self._page = Html(self._gui.add_html(""))
        self._page.show(fleet_rows(robots, moment.at_ns))


def fleet_rows(robots: list[RobotStatus], at_ns: int) -> str:
    """The robots, worst first, as HTML."""
    there = sum(robot.state == "there" for robot in robots)
    rows = [f'<div class="tf-dim">{there} of {counted(len(robots), "robot")} there</div>']
    rows += [_row(robot, at_ns) for robot in robots[:_MOST_ROWS]]
    if more := and_more(len(robots), _MOST_ROWS):
        rows.append(f'<div class="tf-dim">{more}: tfbus fleet --all</div>')
    return f'<div class="tf">{"".join(rows)}</div>'


def _row(robot: RobotStatus, at_ns: int) -> str:
    name = escape(robot.name)
    facts = [robot.state_text(at_ns)]
    if robot.state == "there":
        facts = [
            *([] if robot.age_s is None else [f"{duration(robot.age_s)} old"]),
            *([] if robot.messages_hz is None else [f"{robot.messages_hz:.0f} Hz"]),
            *([] if robot.bytes_per_s is None else [f"{robot.bytes_per_s / 1e3:.1f} kB/s"]),
        ]
        if robot.clock_offset_s is not None and abs(robot.clock_offset_s) > MOST_SKEW_S:
            facts.append(f"clock {duration(robot.clock_offset_s)}")
    alarm = "" if robot.is_well else "tf-alarm"
    trouble = f'<div class="tf-why tf-alarm">{escape(robot.trouble)}</div>' if robot.trouble else ""
    return (
        f'<div class="tf-row" data-fleet-row="{name}"><b class="{alarm}">{name}</b>'
        f'<span class="tf-note">{escape(", ".join(facts))}</span></div>{trouble}'
    )
