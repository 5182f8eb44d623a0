"""Zenoh's threads of one session, and the callbacks of the program that they call."""

import traceback
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from tfbus.testing.tasks import Task, Tasks

if TYPE_CHECKING:
    from tfbus.testing.processes import Process

# Threads that Zenoh calls back on, of one session.
_THREADS = 3


class Handler:
    """A callback of the program, and the function to call after the last."""

    def __init__(self, handler: Any) -> None:
        is_plain = callable(handler) and not hasattr(handler, "callback")
        self.call = handler if is_plain else handler.callback
        self.drop = None if is_plain else handler.drop


class Callers:
    """Zenoh's threads of one session: the calls of one origin come in order."""

    def __init__(self, tasks: Tasks, process: "Process", name: str) -> None:
        self._tasks = tasks
        self._process = process
        self._name = name
        self._calls: dict[object, deque[Callable[[], object]]] = {}
        self._waiting: deque[object] = deque()
        self._idle: list[Task] = []
        self._started = 0

    def post(self, origin: object, call: Callable[[], object]) -> None:
        """Make this call after the earlier ones of its origin."""
        calls = self._calls.get(origin)
        if calls is not None:
            calls.append(call)
            return
        self._calls[origin] = deque((call,))
        self._waiting.append(origin)
        if self._idle:
            self._tasks.wake(self._idle.pop(0))
        elif self._started < _THREADS:
            self._started += 1
            self._tasks.start(f"{self._name} {self._started}", self._process, self._run)

    def _run(self) -> None:
        tasks = self._tasks
        while True:
            while self._waiting:
                origin = self._waiting.popleft()
                calls = self._calls[origin]
                while calls:
                    guarded(calls.popleft())
                    tasks.step()
                del self._calls[origin]
            self._idle.append(tasks.current)
            tasks.wait("a call of Zenoh")


def guarded(call: Callable[[], object]) -> None:
    """Make a call as Zenoh does: exceptions are printed, and do nothing else."""
    try:
        call()
    except Exception:
        traceback.print_exc()
