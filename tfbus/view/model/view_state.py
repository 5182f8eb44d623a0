"""The state of the page: what all its browsers share, and the frame that each has selected."""

import threading
from collections.abc import Callable, Collection
from dataclasses import replace
from typing import Any

from tfbus.view.model.playback import Playback
from tfbus.view.model.settings import ViewSettings


class Selections:
    """The selected frame of each browser, by the number of its client; safe from any thread.

    A browser starts with the frame that was selected last, so that a reload keeps it.
    """

    def __init__(self, first: str = "") -> None:
        self._lock = threading.Lock()
        self._last = first
        self._chosen: dict[int, str] = {}

    def of(self, client: int) -> str:
        """The frame that a browser has selected; "" for none."""
        with self._lock:
            return self._chosen.setdefault(client, self._last)

    @property
    def chosen(self) -> frozenset[str]:
        """The frames that any browser has selected."""
        with self._lock:
            return frozenset(name for name in self._chosen.values() if name)

    def select(self, client: int, frame: str) -> None:
        """Select a frame in one browser."""
        with self._lock:
            self._last = self._chosen[client] = frame

    def keep(self, clients: Collection[int]) -> None:
        """Forget the browsers that are not among these; note where new ones start."""
        with self._lock:
            self._chosen = {client: self._chosen.get(client, self._last) for client in clients}


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
