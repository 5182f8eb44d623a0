"""The way between two frames: distance, angle, and tf2_echo's block."""

import shlex
from html import escape

import viser

from tfbus.buffer.buffer import Buffer
from tfbus.view.model.shown_frames import Frames
from tfbus.view.model.view_state import ViewState
from tfbus.view.panels import text
from tfbus.view.panels.frame_dropdown import FrameDropdown
from tfbus.view.panels.markup import Html


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
        self._from.show(names, settings.measure_from)
        self._to.show(names, settings.measure_to)
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
