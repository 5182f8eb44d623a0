"""The controls of time: follow, pause, and a slider back through what the buffer holds."""

from collections.abc import Callable
from typing import Any

import viser

from tfbus.view.model.playback import Playback
from tfbus.view.model.view_state import Desk


class TimePanel:
    """`newest_ns()` is the time to hold when somebody pauses."""

    def __init__(
        self, gui: viser.GuiApi, desk: Desk, history_s: float, newest_ns: Callable[[], int]
    ) -> None:
        self._desk = desk
        self._button = gui.add_button("Pause", icon=viser.Icon.PLAYER_PAUSE)
        # viser's handles let their value be set, which mypy does not see.
        self._ago: Any = gui.add_slider(
            "Seconds ago",
            -history_s,
            0.0,
            0.01,
            0.0,
            hint="Drag to the left to see the past; what is older than the buffer is gone.",
        )
        self._shown = desk.playback

        @self._button.on_click
        def _(event: Any) -> None:
            if desk.playback.follows:
                desk.play(lambda playback: playback.pause(newest_ns()))
            else:
                desk.play(lambda playback: Playback())

        @self._ago.on_update
        def _(event: Any) -> None:
            if event.client is not None:
                desk.play(lambda playback: playback.scrub(newest_ns(), -self._ago.value))

    def refresh(self) -> None:
        """Show how the time goes."""
        playback = self._desk.playback
        if playback == self._shown:
            return
        self._shown = playback
        self._button.label = "Pause" if playback.follows else "Follow"
        self._button.icon = viser.Icon.PLAYER_PAUSE if playback.follows else viser.Icon.PLAYER_PLAY
        if self._ago.value != -playback.ago_s:
            self._ago.value = -playback.ago_s
