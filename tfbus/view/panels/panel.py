"""The panel next to the scene: its headline, the time, a tab for each kind of question, and one
of the fleet, with a line a robot, as `tfbus fleet` has it.
"""

import time
from collections.abc import Callable, Sequence
from html import escape
from pathlib import Path
from typing import Any

import viser

from tfbus.base.wording import and_more, counted, duration, listed, printable
from tfbus.buffer.buffer import Buffer
from tfbus.frames.clocks import MOST_SKEW_S
from tfbus.frames.fleet import FleetWatch, RobotStatus
from tfbus.frames.moment import BusMoment
from tfbus.view.data.topics import ToolPublishers
from tfbus.view.frames import FAULTS, Frames, Placed, newest_common_ns
from tfbus.view.panels.controls import (
    Control,
    DisplayPanel,
    MovesCameras,
    add_camera_commands,
)
from tfbus.view.panels.data import DataPanel
from tfbus.view.panels.markup import Channel, Html, clock_time, sign
from tfbus.view.panels.player import PlayerBar
from tfbus.view.panels.robots import RobotsPanel, progress_text
from tfbus.view.panels.tools import STYLE as TOOLS_STYLE
from tfbus.view.panels.tools import ToolsPanel
from tfbus.view.panels.tools import script as tools_script
from tfbus.view.panels.tree import SCRIPT as TREE_SCRIPT
from tfbus.view.panels.tree import MeasurePanel, TreePanel
from tfbus.view.replay import Replay
from tfbus.view.scene.data import DataScenes
from tfbus.view.scene.drawn import Guest
from tfbus.view.scene.robots import RobotScenes
from tfbus.view.settings import Playback, Selections, ViewState


class TimePanel:
    """`newest_ns()` is the time to hold on a pause."""

    def __init__(
        self, gui: viser.GuiApi, view: ViewState, history_s: float, newest_ns: Callable[[], int]
    ) -> None:
        self._view = view
        self._button = gui.add_button("Pause", icon=viser.Icon.PLAYER_PAUSE)
        ago = gui.add_slider(
            "Seconds ago",
            -history_s,
            0.0,
            0.01,
            0.0,
            hint="Drag to the left to see the past, as far back as --history.",
        )
        self._ago = Control(
            ago, lambda value: view.play(lambda playback: playback.scrub(newest_ns(), -value))
        )
        self._shown = view.playback

        @self._button.on_click
        def _(event: Any) -> None:
            if view.playback.follows:
                view.play(lambda playback: playback.pause(newest_ns()))
            else:
                view.play(lambda playback: Playback())

    def refresh(self) -> None:
        """Follow the playback when a browser has changed it."""
        playback = self._view.playback
        if playback == self._shown:
            return
        self._shown = playback
        self._button.label = "Pause" if playback.follows else "Follow"
        self._button.icon = viser.Icon.PLAYER_PAUSE if playback.follows else viser.Icon.PLAYER_PLAY
        self._ago.show(-playback.ago_s)


class Panel:
    """All controls; `refresh` brings them up to date.

    Below the tree it says why parts of `robots` cannot be drawn. A `replay` has a bar below the
    scene that plays it. Without a `path` for settings, browsers can neither save them nor send
    anything to the bus; with `tools` they publish by them. `roster` are the robots of a fleet that
    are expected. `newest_ns` is the latest time at which all dynamic frames can be placed.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        view: ViewState,
        selections: Selections,
        camera: MovesCameras,
        guests: Sequence[Guest],
        is_watched: Callable[[], bool],
        history_s: float,
        path: Path | None,
        title: str,
        robots: RobotScenes,
        replay: Replay | None = None,
        roster: tuple[str, ...] = (),
        data: DataScenes | None = None,
        tools: ToolPublishers | None = None,
    ) -> None:
        self._server = server
        self._view = view
        # Guests without their tabs still draw.
        self._guests = () if path is None else guests
        self._is_read_only = path is None
        self.newest_ns = 0
        gui = server.gui
        self._channel = channel = Channel()
        self._replay = replay
        player = (PlayerBar.style(), PlayerBar.script()) if replay else ("", "")
        style = TOOLS_STYLE + player[0] + "".join(guest.style for guest in self._guests)
        script = TREE_SCRIPT + tools_script(sends=tools is not None) + player[1]
        script += "".join(guest.script for guest in self._guests)
        gui.add_html(channel.html(style, script, title))
        channel.listen(gui.add_text("events", ""))
        self._headline = Html(gui.add_html(""))
        # A recording has a timeline of its own in the place of a pause and a way back.
        self._time = None if replay else TimePanel(gui, view, history_s, lambda: self.newest_ns)
        self._player = PlayerBar(gui, channel, replay) if replay else None
        add_camera_commands(gui, camera)
        self.tabs = tabs = gui.add_tab_group()
        with tabs.add_tab("Frames") as tab:
            self._tree = TreePanel(server, tab, view, selections, channel)
            self._mistakes = Html(gui.add_html(""))
        with tabs.add_tab("View"):
            self._display = DisplayPanel(gui, view, selections, path)
        with tabs.add_tab("Tools"):
            self.tools = ToolsPanel(gui, view, channel, tools)
            self._measure = MeasurePanel(gui, view)
        self.fleet = FleetTab(gui, tabs, roster)
        self._data = DataPanel(gui, tabs, view, data, channel) if data else None
        self._scenes = data
        self._subscribers = data.subscribers if data else lambda topic: 0
        for guest in guests:
            guest.join(server.scene, is_watched)
        self._tab_of: dict[Guest, viser.GuiTabHandle] = {}
        self._robots = robots
        self._robots_tab: viser.GuiTabHandle | None = None
        self.robots_panel: RobotsPanel | None = None

    def refresh(
        self, frames: Frames, placed: Placed, fixed_frame: str, buffer: Buffer, now_ns: int
    ) -> None:
        """Show these frames, and the settings as they are."""
        newest_ns = newest_common_ns(buffer, fixed_frame, _not_faded(frames, placed))
        self.newest_ns = now_ns if newest_ns is None else newest_ns
        playback = self._view.playback
        missing = len(placed.missing)
        empty = WAITING
        if self._robots.robots:
            empty = robots_alone([robot.title for robot in self._robots.robots])
        if self._replay:
            empty = nothing_recorded("" if len(frames) else self._replay.hint())
        loading = progress_text(self._robots.progress)
        headline = headline_of(frames, fixed_frame, playback, missing, now_ns, empty, loading)
        if self._replay and self._replay.mistake:
            headline += mistake_lines([self._replay.mistake])
        if self._scenes and (note := self._scenes.note(fixed_frame, frames)):
            headline += mistake_lines([note])
        self._headline.show(headline)
        if self._time:
            self._time.refresh()
        self.follow_player()
        self._tree.refresh(frames, placed, fixed_frame, buffer, now_ns)
        mistakes = self._robots.mistakes()
        self._mistakes.show(mistake_lines(mistakes) if mistakes else "")
        self._measure.refresh(frames, buffer)
        self._refresh_robots(frames)
        if self._data:
            self._data.refresh()
        self.tools.refresh(time.monotonic(), self._subscribers)
        for guest in self._guests:
            self._refresh_guest(guest)
        self._display.refresh(frames)

    def follow_player(self) -> None:
        """Show the time of a recording, if browsers cannot foresee that."""
        if self._player:
            self._player.refresh()

    def _refresh_robots(self, frames: Frames) -> None:
        """Show the tab of robots while there are any."""
        if not self._robots.robots:
            if self._robots_tab is not None:
                self._robots_tab.remove()
            self._robots_tab = self.robots_panel = None
            return
        if self.robots_panel is None or self._robots_tab is None:
            self._robots_tab = self.tabs.add_tab(RobotsPanel.title)
            with self._robots_tab:
                self.robots_panel = RobotsPanel(
                    self._server.gui,
                    self._view,
                    self._channel,
                    self._robots,
                    has_sliders=not self._is_read_only,
                )
        # Its sliders come and go with the robots.
        with self._robots_tab:
            self.robots_panel.refresh(frames)

    def _refresh_guest(self, guest: Guest) -> None:
        """Show the guest's tab, the last one, while the guest is present."""
        if not guest.is_present:
            if tab := self._tab_of.pop(guest, None):
                tab.remove()
            return
        if guest not in self._tab_of:
            self._tab_of[guest] = tab = self.tabs.add_tab(guest.title)
            with tab:
                guest.add_controls(self._server.gui, self._channel)
        guest.refresh()


def _not_faded(frames: Frames, placed: Placed) -> list[str]:
    """The frames that still come: stale and gone ones would hold the time back."""
    return [name for name in placed.names if frames[name].opacity == 1.0]


_MOST_MISTAKES = 5
_MOST_ROOTS = 5

WAITING = (
    "<b>Waiting for transforms.</b> None has come yet: start a broadcaster on this bus, for "
    "example <code>tfbus launch turtle</code>."
)


def headline_of(
    frames: Frames,
    fixed_frame: str,
    playback: Playback,
    missing: int = 0,
    now_ns: int = 0,
    empty: str = WAITING,
    loading: str = "",
) -> str:
    """The headline of the page, or a note that it waits; `now_ns` is the time to judge a pause by.

    `missing` frames have no place at the time shown, besides frames of other trees. `empty` is the
    headline without any frame, as HTML. `loading` says how far the meshes of robots are loaded.
    """
    loads = [f'<span class="tf-note-whole">loading {loading}</span>'] if loading else []
    if not len(frames):
        return f'<div class="tf" role="status">{" · ".join([empty, *loads])}</div>'
    if fixed_frame not in frames:
        known = listed([escape(root) for root in frames.roots], most=_MOST_ROOTS)
        return (
            f'<div class="tf" role="status"><b>There is no frame {escape(repr(fixed_frame))}</b> '
            f"to see the others from; choose another fixed frame. Roots: {known}.</div>"
        )
    counts = {fault: sum(frame.state == fault for frame in frames) for fault in FAULTS}
    notes = [
        f'<span class="tf-note-whole">{sign(fault)} {count} {fault}</span>'
        for fault, count in counts.items()
        if count
    ]
    apart = missing + sum(bool(frame.unplaced) for frame in frames)
    if apart:
        notes.append(f'<span class="tf-alarm tf-note-whole">{apart} without a place</span>')
    parts = [f"{counted(len(frames), 'frame')}, seen from <b>{escape(fixed_frame)}</b>", *notes]
    parts += loads
    if playback.stamp_ns is not None:
        ago_s = (now_ns - playback.stamp_ns) / 1e9
        ago = f", {duration(ago_s)} ago" if ago_s >= 0.1 else ""
        parts.append(f"<b>paused</b> at {clock_time(playback.stamp_ns, now_ns)}{ago}")
    return f'<div class="tf" role="status">{" · ".join(parts)}</div>'


def robots_alone(titles: Sequence[str]) -> str:
    """The note on robots without any frame, as HTML."""
    named = escape(listed([printable(title) for title in titles], most=3))
    return (
        f"<b>No transforms yet.</b> <code>tfbus robot_state</code> publishes the frames of {named} "
        "from <code>joint_states</code>, and <code>tfbus joints</code> publishes those."
    )


def nothing_recorded(hint: str) -> str:
    """The note on a recording without a frame, as HTML; `hint` is where there are some."""
    where = f" {escape(hint[:1].upper() + hint[1:])}." if hint else ""
    return f"<b>No transforms</b> had come by this moment of the recording.{where}"


def mistake_lines(found: Sequence[str]) -> str:
    """A line per mistake, at most five."""
    lines = [*found[:_MOST_MISTAKES]]
    if more := and_more(len(found), _MOST_MISTAKES):
        lines.append(f"{more.capitalize()}; see the log.")
    return "".join(f'<div class="tf tf-alarm" role="alert">{escape(line)}</div>' for line in lines)


# More robots are slow to show; the worst come first.
_MOST_ROBOTS = 150

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
    rows += [_robot_row(robot, at_ns) for robot in robots[:_MOST_ROBOTS]]
    if more := and_more(len(robots), _MOST_ROBOTS):
        rows.append(f'<div class="tf-dim">{more}: tfbus fleet --all</div>')
    return f'<div class="tf">{"".join(rows)}</div>'


def _robot_row(robot: RobotStatus, at_ns: int) -> str:
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
