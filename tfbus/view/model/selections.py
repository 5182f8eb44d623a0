"""Which frame each browser has selected."""

import threading
from collections.abc import Collection


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
