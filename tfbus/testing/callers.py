"""The calls of a session into its program: messages on Zenoh's threads, and their callbacks."""

import traceback
from collections import deque
from collections.abc import Callable
from typing import Any

import zenoh

from tfbus.testing.processes import Process
from tfbus.testing.tasks import Task, Tasks


class Payload:
    """Bytes as Zenoh hands them out."""

    def __init__(self, data: bytes) -> None:
        self._data = data

    def __len__(self) -> int:
        return len(self._data)

    def to_bytes(self) -> bytes:
        return self._data

    def __bytes__(self) -> bytes:
        return self._data


class Source:
    """The origin of a message: the id of the session, the publisher's, and its number."""

    def __init__(self, zid: str, eid: int, number: int) -> None:
        self.zid, self.eid = zid, eid
        self.source_id = self
        self.source_sn = number


class Sample:
    """A message, or the news of a token."""

    def __init__(
        self,
        key: str,
        payload: bytes = b"",
        kind: Any = zenoh.SampleKind.PUT,
        source: Source | None = None,
    ) -> None:
        self.key_expr = key
        self.payload = Payload(payload)
        self.kind = kind
        self.source_info = source


class ReplyError:
    """The reason why there is no answer."""

    def __init__(self, payload: bytes) -> None:
        self.payload = Payload(payload)


class Reply:
    """An answer to a query, or the reason for none."""

    def __init__(
        self, ok: Sample | None = None, error: bytes | None = None, zid: str | None = None
    ) -> None:
        self.ok = ok
        self.err = None if error is None else ReplyError(error)
        self.replier_id = None if zid is None else Source(zid, 0, 0)


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

    def __init__(self, tasks: Tasks, process: Process, name: str) -> None:
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
