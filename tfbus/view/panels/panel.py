"""The panel next to the scene: its headline, the time, and a tab for each kind of question."""

from collections.abc import Callable, Sequence
from pathlib import Path

import viser

from tfbus.buffer.buffer import Buffer
from tfbus.view.guest import Guest
from tfbus.view.model.placement import Placed, newest_common_ns
from tfbus.view.model.shown_frames import Frames
from tfbus.view.model.view_state import ViewState
from tfbus.view.panels import text
from tfbus.view.panels.display import DisplayPanel
from tfbus.view.panels.markup import Channel, Html
from tfbus.view.panels.measure import MeasurePanel
from tfbus.view.panels.time import TimePanel
from tfbus.view.panels.tree import TreePanel


class Panel:
    """All controls; `refresh` brings them up to date.

    `mistakes` are shown below the tree: why parts of a robot cannot be drawn. `newest_ns` is the
    latest time at which all dynamic frames can be placed.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        view: ViewState,
        guests: Sequence[Guest],
        is_watched: Callable[[], bool],
        history_s: float,
        path: Path,
        mistakes: Sequence[str] = (),
    ) -> None:
        self._view = view
        self._guests = guests
        self.newest_ns = 0
        gui = server.gui
        channel = Channel()
        style = "".join(guest.style for guest in guests)
        script = "".join(guest.script for guest in guests)
        gui.add_html(channel.html(style, script))
        typed = gui.add_text("events", "")
        typed.on_update(lambda event: channel.receive(typed.value))
        self._headline = Html(gui.add_html(""))
        self._time = TimePanel(gui, view, history_s, lambda: self.newest_ns)
        tabs = gui.add_tab_group()
        with tabs.add_tab("Frames"):
            self._tree = TreePanel(gui, view, channel)
            if mistakes:
                gui.add_html(text.mistakes(mistakes))
        with tabs.add_tab("Measure"):
            self._measure = MeasurePanel(gui, view)
        for guest in guests:
            with tabs.add_tab(guest.title):
                guest.join(gui, server.scene, channel, is_watched)
        with tabs.add_tab("View"):
            self._display = DisplayPanel(gui, view, path)

    def refresh(
        self, frames: Frames, placed: Placed, fixed_frame: str, buffer: Buffer, now_ns: int
    ) -> None:
        """Show these frames, and the settings as they are."""
        newest_ns = newest_common_ns(buffer, fixed_frame, _not_faded(frames, placed))
        self.newest_ns = now_ns if newest_ns is None else newest_ns
        playback = self._view.playback
        missing = len(placed.missing)
        self._headline.show(text.headline(frames, fixed_frame, playback, missing))
        self._time.refresh()
        self._tree.refresh(frames, placed, fixed_frame, buffer, now_ns)
        self._measure.refresh(frames, buffer)
        for guest in self._guests:
            guest.refresh()
        self._display.refresh()


def _not_faded(frames: Frames, placed: Placed) -> list[str]:
    """The frames that still come: stale and gone ones would hold the time back."""
    return [name for name in placed.names if frames[name].opacity == 1.0]
