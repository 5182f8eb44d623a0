"""Waiting for a transform: which waiters a new sample wakes.

A waiter is woken when the edges of its path have samples up to its time, or none that old any
longer, or when a frame of the path gets another parent. So thousands of waiters cost an insert only
a look at the first alarm of the edge.
"""

import heapq
import itertools
from collections.abc import Callable, Iterable

from tfbus.buffer.lock import Lock
from tfbus.buffer.tree import Tree
from tfbus.core.kernel import NO_DATA, History

# Target frame, source frame, stamp in nanoseconds or None for the latest.
Question = tuple[str, str, int | None]

_FIRST_PURGE = 64


class Waiter:
    """A lookup that waits: `wake` is called from the thread that inserts, and returns at once.

    `past_of` is the authority whose past it waits for, None if it waits for something else.
    """

    __slots__ = ("gone", "past_of", "wake")

    def __init__(self, wake: Callable[[], None]) -> None:
        self.wake = wake
        self.gone = False
        self.past_of: str | None = None


class _Queue:
    """Waiters by the stamps that they wait for, earliest first."""

    def __init__(self) -> None:
        self._heap: list[tuple[int, int, Waiter]] = []
        self._tickets = itertools.count()
        self._purge_at = _FIRST_PURGE

    def push(self, stamp_ns: int, waiter: Waiter) -> None:
        if len(self._heap) >= self._purge_at:
            self._heap = [entry for entry in self._heap if not entry[2].gone]
            heapq.heapify(self._heap)
            self._purge_at = max(_FIRST_PURGE, 2 * len(self._heap))
        heapq.heappush(self._heap, (stamp_ns, next(self._tickets), waiter))

    def pop_until(self, stamp_ns: int) -> list[Waiter]:
        """Remove and return those whose stamp is at most this one."""
        due = []
        while self._heap and self._heap[0][0] <= stamp_ns:
            due.append(heapq.heappop(self._heap)[2])
        return due


class Alarms:
    """The waiters of one frame, by what wakes them."""

    def __init__(self) -> None:
        self.arriving = _Queue()
        self.expiring = _Queue()
        # In the order in which they began to wait.
        self.moving: dict[Waiter, None] = {}


class Waiters:
    """All waiters of a buffer, behind its lock, which is not held while waking."""

    def __init__(self, tree: Tree, lock: Lock) -> None:
        self._tree = tree
        self._lock = lock
        self._places: dict[Waiter, list[dict[Waiter, None]]] = {}
        # By frames that are not in the tree yet.
        self._unknown: dict[str, dict[Waiter, None]] = {}

    def __len__(self) -> int:
        return len(self._places)

    def add(self, waiter: Waiter) -> None:
        """Add a waiter; from now on the tree notes what it stores."""
        with self._lock:
            self._places[waiter] = []
            if self._tree.touched is None:
                self._tree.touched, self._tree.moved = [], []

    def discard(self, waiter: Waiter) -> None:
        """Never wake this one again."""
        with self._lock:
            waiter.gone = True
            for place in self._places.pop(waiter):
                place.pop(waiter, None)
            self._unknown = {name: those for name, those in self._unknown.items() if those}
            if not self._places:
                self._tree.touched = self._tree.moved = None

    def watch(self, waiter: Waiter, questions: Iterable[Question]) -> None:
        """Wake it when the answers to the questions may have changed.

        Called with the buffer's lock held. Look up again after this and before waiting: earlier
        changes do not wake it.
        """
        for target_frame, source_frame, stamp_ns in questions:
            self._watch_one(waiter, target_frame, source_frame, stamp_ns)

    def due(self, touched: Iterable[History], moved: Iterable[History]) -> list[Waiter]:
        """The waiters to wake, of frames that got a sample, and of frames that got a parent.

        Called with the buffer's lock held.
        """
        woken: list[Waiter] = []
        for history in touched:
            woken += self._unknown.pop(history.name, ())
            alarms, span = history.alarms, history.stamp_span()
            if isinstance(alarms, Alarms) and span is not None:
                woken += alarms.arriving.pop_until(span[1])
                woken += alarms.expiring.pop_until(span[0] - 1)
        for history in moved:
            if isinstance(history.alarms, Alarms):
                woken += history.alarms.moving
        return [waiter for waiter in dict.fromkeys(woken) if not waiter.gone]

    def wake_all(self) -> None:
        """Wake all waiters."""
        for waiter in list(self._places):
            waiter.wake()

    def _watch_one(
        self, waiter: Waiter, target_frame: str, source_frame: str, stamp_ns: int | None
    ) -> None:
        ends = [self._tree.frames.get(frame) for frame in (target_frame, source_frame)]
        for frame, end in zip((target_frame, source_frame), ends, strict=True):
            if end is None:
                self._place(waiter, self._unknown.setdefault(frame, {}))
        known = [end for end in ends if end is not None]
        if len(known) < 2:
            return
        path = self._tree.path(target_frame, source_frame)
        if path is None:
            for end in known:
                for history in self._tree.chain(end):
                    self._place(waiter, _alarms(history).moving)
            return
        for history in path.edges():
            alarms, span = _alarms(history), history.stamp_span()
            self._place(waiter, alarms.moving)
            if history.static:
                continue
            if span is None or stamp_ns is None:
                alarms.arriving.push(NO_DATA, waiter)
            elif stamp_ns > span[1]:
                alarms.arriving.push(stamp_ns, waiter)
            else:
                alarms.expiring.push(stamp_ns, waiter)

    def _place(self, waiter: Waiter, place: dict[Waiter, None]) -> None:
        if waiter not in place:
            place[waiter] = None
            self._places[waiter].append(place)


def _alarms(history: History) -> Alarms:
    if not isinstance(history.alarms, Alarms):
        # They lead to those who wait, and these perhaps back to the buffer.
        history.track()
        history.alarms = Alarms()
    return history.alarms
