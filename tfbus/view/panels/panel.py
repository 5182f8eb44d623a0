"""The panel beside the scene: its headline, the time, and a tab for each kind of question."""

import json
from collections.abc import Sequence
from pathlib import Path

import viser

from tfbus import Buffer
from tfbus.nodes.turtle.view.panel import TurtlePanel
from tfbus.nodes.turtle.view.turtles import KEYS, Turtles
from tfbus.view.model.frames import Frames
from tfbus.view.model.placement import Placed, newest_common_ns
from tfbus.view.model.view_state import Desk
from tfbus.view.panels import text
from tfbus.view.panels.display import DisplayPanel
from tfbus.view.panels.markup import Channel, Html
from tfbus.view.panels.measure import MeasurePanel
from tfbus.view.panels.time import TimePanel
from tfbus.view.panels.tree import TreePanel


class Panel:
    """All controls; `refresh` lets them show how things stand.

    `mistakes` are said below the tree: what of a robot cannot be drawn.

    `newest_ns` is the latest time at which all that moves can be placed.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        desk: Desk,
        turtles: Turtles,
        history_s: float,
        path: Path,
        mistakes: Sequence[str] = (),
    ) -> None:
        self._desk = desk
        self.newest_ns = 0
        channel = Channel()
        gui.add_html(channel.html(json.dumps(KEYS)))
        typed = gui.add_text("events", "")
        typed.on_update(lambda event: channel.receive(typed.value))
        self._headline = Html(gui.add_html(""))
        self._time = TimePanel(gui, desk, history_s, lambda: self.newest_ns)
        tabs = gui.add_tab_group()
        with tabs.add_tab("Frames"):
            self._tree = TreePanel(gui, desk, channel)
            if mistakes:
                gui.add_html(text.mistakes(mistakes))
        with tabs.add_tab("Measure"):
            self._measure = MeasurePanel(gui, desk)
        with tabs.add_tab("Turtles"):
            self._turtles = TurtlePanel(gui, turtles, channel)
        with tabs.add_tab("View"):
            self._display = DisplayPanel(gui, desk, path)

    def refresh(
        self, frames: Frames, placed: Placed, fixed_frame: str, buffer: Buffer, now_ns: int
    ) -> None:
        """Show these frames, and the settings as they are."""
        newest_ns = newest_common_ns(buffer, fixed_frame, _fresh(frames, placed))
        self.newest_ns = now_ns if newest_ns is None else newest_ns
        playback = self._desk.playback
        missing = len(placed.missing)
        self._headline.show(text.headline(frames, fixed_frame, playback, missing))
        self._time.refresh()
        self._tree.refresh(frames, placed, fixed_frame, buffer, now_ns)
        self._measure.refresh(frames, buffer)
        self._turtles.refresh()
        self._display.refresh()


def _fresh(frames: Frames, placed: Placed) -> list[str]:
    """The frames that still move: the others would hold the time back."""
    return [name for name in placed.names if frames.states[name].opacity == 1.0]
