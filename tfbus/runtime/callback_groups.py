"""Groups of callbacks: which callbacks of a node may run at once."""

from collections import deque
from typing import Any

from tfbus.runtime import scheduler


class Admission:
    """Which tasks of a group may run now: all of them.

    Each `enter` that returns a task, and each `leave` that does, is followed by a `leave` when that
    task has run. Safe from any thread, and from a signal handler in the middle of a call.
    """

    def enter(self, task: Any) -> Any:
        """Take a task; the one that may run now, None if it has to wait."""
        return task

    def leave(self) -> Any:
        """Note that a task has run; the next that may run now, None if there is none."""
        return None

    def waiting(self) -> list[Any]:
        """The tasks that wait for others to end, in order."""
        return []


class OneAtATime(Admission):
    """A task after the other, in their order."""

    def __init__(self) -> None:
        # Each step below is a single operation.
        self._runs = scheduler.Lock()  # held while a task runs
        self._waiting: deque[Any] = deque()

    def enter(self, task: Any) -> Any:
        self._waiting.append(task)
        return self._next()

    def leave(self) -> Any:
        self._runs.release()
        return self._next()

    def waiting(self) -> list[Any]:
        return list(self._waiting)

    def _next(self) -> Any:
        while self._waiting and self._runs.acquire(blocking=False):
            try:
                return self._waiting.popleft()
            except IndexError:  # another thread took it: look again, as one may have come meanwhile
                self._runs.release()
        return None


class CallbackGroup:
    """A group of callbacks of one node, which run on threads beside those of its other callbacks.

    Give it to `create_subscription`, `create_timer`, `create_service` and others. A callback
    without a group is in the node's own, which is mutually exclusive and has the node's thread.
    """

    def __init__(self) -> None:
        self.admission = Admission()
        # The full name of the node that it is of.
        self.owner: str | None = None


class MutuallyExclusiveCallbackGroup(CallbackGroup):
    """Callbacks that run one at a time, in the order in which they became due, beside those of the
    node's other groups.

    Give one group to `create_subscription`, `create_timer`, `create_service` and others of a node.
    """

    def __init__(self) -> None:
        super().__init__()
        self.admission = OneAtATime()


class ReentrantCallbackGroup(CallbackGroup):
    """Callbacks that may all run at once, also several calls of the same one: they need locks for
    what they share.
    """


def join(group: CallbackGroup, owner: str) -> None:
    """Let the group belong to the node of this name. Raises ValueError if it is of another."""
    if group.owner not in (None, owner):
        raise ValueError(
            f"this callback group is of node {group.owner}: make another for {owner}, "
            f"{type(group).__name__}()"
        )
    group.owner = owner
