"""The controls of time: follow, pause, and a slider back through the buffer."""

from collections.abc import Callable
from typing import Any

import viser

from tfbus.view.model.playback import Playback
from tfbus.view.model.view_state import ViewState


class TimePanel:
    """`newest_ns()` is the time to hold on a pause."""

    def __init__(
        self, gui: viser.GuiApi, view: ViewState, history_s: float, newest_ns: Callable[[], int]
    ) -> None:
        self._view = view
        self._button = gui.add_button("Pause", icon=viser.Icon.PLAYER_PAUSE)
        # The value of viser's handles can be set, which mypy does not see.
        self._ago: Any = gui.add_slider(
            "Seconds ago",
            -history_s,
            0.0,
            0.01,
            0.0,
            hint="Drag to the left to see the past, as far back as --history.",
        )
        self._shown = view.playback

        @self._button.on_click
        def _(event: Any) -> None:
            if view.playback.follows:
                view.play(lambda playback: playback.pause(newest_ns()))
            else:
                view.play(lambda playback: Playback())

        @self._ago.on_update
        def _(event: Any) -> None:
            if event.client is not None:
                view.play(lambda playback: playback.scrub(newest_ns(), -self._ago.value))

    def refresh(self) -> None:
        """Follow the playback when a browser has changed it."""
        playback = self._view.playback
        if playback == self._shown:
            return
        self._shown = playback
        self._button.label = "Pause" if playback.follows else "Follow"
        self._button.icon = viser.Icon.PLAYER_PAUSE if playback.follows else viser.Icon.PLAYER_PLAY
        if self._ago.value != -playback.ago_s:
            self._ago.value = -playback.ago_s
