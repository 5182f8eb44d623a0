"""The panel next to the scene: its headline, the time, and a tab for each kind of question."""

import shlex
from collections.abc import Callable, Sequence
from html import escape
from pathlib import Path
from typing import Any

import viser

from tfbus.buffer.buffer import Buffer
from tfbus.view.guest import Guest
from tfbus.view.model.frames import Frames, Placed, newest_common_ns
from tfbus.view.model.settings import Playback, Selections, ViewState
from tfbus.view.panels import text
from tfbus.view.panels.controls import (
    Control,
    DisplayPanel,
    FrameDropdown,
    MovesCameras,
    add_camera_commands,
)
from tfbus.view.panels.fleet import FleetTab
from tfbus.view.panels.markup import Channel, Html
from tfbus.view.panels.player import PlayerBar
from tfbus.view.panels.robots import RobotsPanel, progress_text
from tfbus.view.panels.tree import SCRIPT as TREE_SCRIPT
from tfbus.view.panels.tree import TreePanel
from tfbus.view.replay import Replay
from tfbus.view.scene.robots import RobotScenes


class MeasurePanel:
    """Shows where one frame is, seen from another, as `tfbus echo` prints it."""

    def __init__(self, gui: viser.GuiApi, view: ViewState) -> None:
        self._view = view
        self._from = FrameDropdown(
            gui, "Seen from", "choose a frame", lambda name: view.change(measure_from=name)
        )
        self._to = FrameDropdown(
            gui, "Frame", "choose a frame", lambda name: view.change(measure_to=name)
        )
        self._answer = Html(gui.add_html(""))

    def refresh(self, frames: Frames, buffer: Buffer) -> None:
        """Show the answer at the time shown."""
        settings = self._view.settings
        names = sorted(frames.by_name)
        self._from.offer(names, settings.measure_from)
        self._to.offer(names, settings.measure_to)
        if not settings.measure_from or not settings.measure_to:
            self._answer.show(
                '<div class="tf tf-dim">Choose two frames to see how far apart they are.</div>'
            )
            return
        summary, block = text.between(
            buffer, settings.measure_from, settings.measure_to, self._view.playback.stamp_ns
        )
        if not summary:
            self._answer.show(f'<div class="tf tf-alarm">{escape(block)}</div>')
            return
        title = shlex.join(["tfbus", "echo", settings.measure_from, settings.measure_to])
        self._answer.show(
            f'<div class="tf"><b>{escape(summary)}</b>{text.numbers(title, "tf-echo", block)}</div>'
        )


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
    anything to the bus. `roster` are the robots of a fleet that are expected. `newest_ns` is
    the latest time at which all dynamic frames can be placed.
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
        style = player[0] + "".join(guest.style for guest in self._guests)
        script = TREE_SCRIPT + player[1] + "".join(guest.script for guest in self._guests)
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
        with tabs.add_tab("Measure"):
            self._measure = MeasurePanel(gui, view)
        with tabs.add_tab("View"):
            self._display = DisplayPanel(gui, view, selections, path)
        self.fleet = FleetTab(gui, tabs, roster)
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
        empty = text.WAITING
        if self._robots.robots:
            empty = text.robots_alone([robot.title for robot in self._robots.robots])
        if self._replay:
            empty = text.nothing_recorded("" if len(frames) else self._replay.hint())
        loading = progress_text(self._robots.progress)
        headline = text.headline(frames, fixed_frame, playback, missing, now_ns, empty, loading)
        if self._replay and self._replay.mistake:
            headline += text.mistakes([self._replay.mistake])
        self._headline.show(headline)
        if self._time:
            self._time.refresh()
        self.follow_player()
        self._tree.refresh(frames, placed, fixed_frame, buffer, now_ns)
        mistakes = self._robots.mistakes()
        self._mistakes.show(text.mistakes(mistakes) if mistakes else "")
        self._measure.refresh(frames, buffer)
        self._refresh_robots(frames)
        for guest in self._guests:
            self._refresh_guest(guest)
        self._display.refresh()

    def follow_player(self) -> None:
        """Show where a recording is shown, if browsers cannot foresee that."""
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
