"""asyncio in virtual time: an event loop whose waits are those of a simulated task."""

import asyncio
from typing import Any

from tfbus.testing.primitives import Event
from tfbus.testing.tasks import Tasks


class _Waiting:
    """Stands in for the files of a loop, of which a simulated process has none."""

    def __init__(self, tasks: Tasks) -> None:
        self.event = Event(tasks)

    def select(self, timeout: float | None = None) -> list[Any]:
        if timeout is None or timeout > 0:
            self.event.wait(timeout)
        self.event.clear()
        return []


class SimulatedEventLoop(asyncio.BaseEventLoop):
    """An event loop of one simulated task; others may call `call_soon_threadsafe`."""

    def __init__(self, tasks: Tasks) -> None:
        super().__init__()
        self._tasks = tasks
        self._selector = _Waiting(tasks)
        self._clock_resolution = 1e-9

    def time(self) -> float:
        """The virtual time, in seconds."""
        return self._tasks.now_ns / 1e9

    def _process_events(self, event_list: list[Any]) -> None:
        pass

    def _write_to_self(self) -> None:
        self._selector.event.set()
