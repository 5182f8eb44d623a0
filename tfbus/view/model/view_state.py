"""The state of the page, chosen by all its browsers together; safe from any thread."""

import threading
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from tfbus.view.model.playback import Playback
from tfbus.view.model.settings import ViewSettings


class ViewState:
    """The settings and the playback; the controls change them, the page reads them."""

    def __init__(self, settings: ViewSettings) -> None:
        self._lock = threading.Lock()
        self.settings = settings
        self.playback = Playback()

    def change(self, **values: Any) -> None:
        """Set some of the fields of ViewSettings."""
        with self._lock:
            self.settings = replace(self.settings, **values)

    def tick(self, field: str, frame: str, is_in: bool) -> None:
        """Put a frame into a list of frames, `hidden` or `trails`, or take it out."""
        with self._lock:
            others = tuple(name for name in getattr(self.settings, field) if name != frame)
            chosen: dict[str, Any] = {field: (*others, frame) if is_in else others}
            self.settings = replace(self.settings, **chosen)

    def play(self, step: Callable[[Playback], Playback]) -> None:
        """Replace the playback by what `step` makes of it."""
        with self._lock:
            self.playback = step(self.playback)
