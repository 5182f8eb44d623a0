"""The state of a buffer behind one lock, and its waiters and listeners.

A lookup that waits is woken when the edges of its path have samples up to its time, or none that
old any longer, or when a frame of the path gets another parent. So thousands of waiters cost an
insert only a look at the first alarm of the edge.

Compiled if there is a C compiler (`store.pxd` has the C types).
"""

import heapq
import itertools
import logging
import sys
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress

from tfbus.base.errors import (
    ConnectivityException,
    LookupException,
    PastExtrapolationException,
    SingleSampleException,
    TransformException,
)
from tfbus.base.log import LogOnce
from tfbus.base.wording import printable
from tfbus.buffer.explain import mistake_of, unknown_frame
from tfbus.buffer.info import Change, Rejections
from tfbus.buffer.insert_many import BatchInserter
from tfbus.buffer.lock import Lock
from tfbus.buffer.tree import Question, Tree
from tfbus.geometry.kernel import LONGEST_NS, NO_DATA, History, Path
from tfbus.geometry.sampling import TF2, Sampling
from tfbus.geometry.transform import TransformStamped, child_name

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
    """Waiters by the stamps that they wait for, earliest first, each once for a stamp."""

    def __init__(self) -> None:
        self._heap: list[tuple[int, int, Waiter]] = []
        # A waiter that another edge wakes time and again asks for the same again.
        self._asked: set[tuple[int, Waiter]] = set()
        self._tickets = itertools.count()
        self._purge_at = _FIRST_PURGE

    def push(self, stamp_ns: int, waiter: Waiter) -> None:
        if (stamp_ns, waiter) in self._asked:
            return
        if len(self._heap) >= self._purge_at:
            self._heap = [entry for entry in self._heap if not entry[2].gone]
            heapq.heapify(self._heap)
            self._asked = {(at_ns, each) for at_ns, _, each in self._heap}
            self._purge_at = max(_FIRST_PURGE, 2 * len(self._heap))
        heapq.heappush(self._heap, (stamp_ns, next(self._tickets), waiter))
        self._asked.add((stamp_ns, waiter))

    def pop_until(self, stamp_ns: int) -> list[Waiter]:
        """Remove and return the waiters whose stamp is at most this one."""
        due = []
        while self._heap and self._heap[0][0] <= stamp_ns:
            at_ns, _, waiter = heapq.heappop(self._heap)
            self._asked.discard((at_ns, waiter))
            due.append(waiter)
        return due


class Alarms:
    """The waiters of one frame, by the change that wakes them."""

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
        """Add a waiter; from now on the tree notes the histories that it stores into."""
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
        # They lead to the waiters, and these perhaps back to the buffer.
        history.track()
        history.alarms = Alarms()
    return history.alarms


# Gets each pair of frames that is looked up; and explains, if it can, why one has no answer.
QuestionWatcher = tuple[
    Callable[[str, str], object], Callable[[str, str], "TransformException | None"]
]

# A buffer that has just started holds less than it will: lookups of older times say nothing yet.
_FULL = 0.9

_log = logging.getLogger(__name__)


class Store:
    """The tree of frames, its lock, and the callbacks and waiters to notify.

    The lock is held for one transform, or for the rows of one batch, of which at most 256 may bring
    new frames, and never during a callback.
    """

    def __init__(
        self,
        cache_time_s: float,
        sampling: Sampling,
        clock: Callable[[], int],
        max_samples: int = sys.maxsize,
    ) -> None:
        self.sampling = TF2 if sampling == TF2 else sampling
        self.clock = clock
        self.is_ended = False
        self.rejected = Rejections()
        self.expired_lookups = ExpiredLookups(cache_time_s)
        self.tree = Tree(round(min(cache_time_s * 1e9, LONGEST_NS)), max_samples)
        self.lock = Lock(self.tree.forget_paths)
        self.inserter = BatchInserter(self.tree, self.rejected, self.lock)
        self.waiters = Waiters(self.tree, self.lock)
        self.expected_pasts: dict[str, int] = {}
        self._listeners: list[Callable[[Change], None]] = []
        self._watchers: list[QuestionWatcher] = []
        self._once = LogOnce(_log)

    def insert(self, transform: TransformStamped, static: bool, authority: str) -> bool:
        """With the lock held: take one transform; False if it is too old to be kept."""
        return self.tree.insert(
            transform._frame_id,
            child_name(transform),
            transform._stamp_ns,
            transform._pose,
            static,
            authority,
        )

    def path(self, target_frame: str, source_frame: str) -> Path | None:
        """The path as the tree is now; None if a frame is unknown or nothing joins them."""
        with self.lock:
            return self.tree.path(target_frame, source_frame)

    def unknown_frame(self, frame: str) -> LookupException:
        """The error for a frame that is not in the tree."""
        with self.lock:
            names = list(self.tree.frames)
        return unknown_frame(frame, names)

    # Notifying; all of it without the lock

    def notify(self) -> None:
        """Wake the waiters and call the listeners that the last changes concern."""
        if self.lock.later(self.notify):
            return
        tree = self.tree
        with self.lock:
            touched, moved, news = tree.touched, tree.moved, tree.news
            if touched is not None:
                tree.touched, tree.moved = [], []
            if news is not None:
                tree.news = []
            woken = self.waiters.due(touched or (), moved or ())
            listeners = self._listeners
        for waiter in woken:
            waiter.wake()
        for change in news or ():
            for listener in listeners:
                try:
                    listener(change)
                except Exception:
                    _log.exception("A change callback failed")
        if tree.unreported:
            self.report_questions()
        if tree.crowded:
            self._warn_crowded()

    def _warn_crowded(self) -> None:
        with self.lock:
            crowded, self.tree.crowded = self.tree.crowded, []
            spans = [history.stamp_span() for history in crowded]
        for history, span in zip(crowded, spans, strict=True):
            covered_s = (span[1] - span[0]) / 1e9 if span else 0.0
            self._once.warning(
                "crowded",
                "Frame %s has more than %d samples within the cache time: the oldest are dropped, "
                "and the others cover %.3g s. Are its stamps in nanoseconds? Otherwise allow more "
                "(max_samples)",
                repr(printable(history.name)),
                self.tree.max_samples,
                covered_s,
            )

    def report_questions(self) -> None:
        """Give the watchers the pairs of frames that were looked up."""
        if self.lock.later(self.report_questions):
            return
        with self.lock:
            unreported, self.tree.unreported = self.tree.unreported, []
            watchers = self._watchers
        for target_frame, source_frame in unreported:
            for callback, _ in watchers:
                try:
                    callback(target_frame, source_frame)
                except Exception:
                    _log.exception("A watcher of questions failed")

    def explained(
        self, error: TransformException, questions: Sequence[Question]
    ) -> TransformException:
        """The error of a lookup, or the better one of a watcher for a frame that is unknown or not
        connected; without the lock, as watchers may do anything.
        """
        if self.tree.unreported:
            self.report_questions()
        self.expired_lookups.record(error)
        if self._watchers and isinstance(error, LookupException | ConnectivityException):
            for target_frame, source_frame, _ in questions:
                if self.path(target_frame, source_frame) is None:
                    for _, explain in self._watchers:
                        better = explain(target_frame, source_frame)
                        if better is not None:
                            return better
        return error

    # Who is notified

    def on_change(self, listener: Callable[[Change], None]) -> Callable[[], None]:
        """As `Buffer.on_change`."""
        with self.lock:
            self._listeners = [*self._listeners, listener]
            if self.tree.news is None:
                self.tree.news = []

        def end() -> None:
            with self.lock:
                with suppress(ValueError):
                    others = list(self._listeners)
                    others.remove(listener)
                    self._listeners = others
                if not self._listeners:
                    self.tree.news = None

        return end

    def watch_questions(
        self,
        callback: Callable[[str, str], object],
        explain: Callable[[str, str], "TransformException | None"],
    ) -> Callable[[], None]:
        """As `Buffer.watch_questions`."""
        watcher = (callback, explain)
        with self.lock:
            self._watchers = [*self._watchers, watcher]
            self.tree.asked = set()
            self.tree.topology += 1

        def end() -> None:
            with self.lock:
                self._watchers = [each for each in self._watchers if each is not watcher]
                if not self._watchers:
                    self.tree.asked = None

        return end

    def expect_past(self, authority: str) -> Callable[[], None]:
        """As `Buffer.expect_past`."""
        with self.lock:
            self.expected_pasts[authority] = self.expected_pasts.get(authority, 0) + 1

        def end() -> None:
            with self.lock:
                left = self.expected_pasts[authority] - 1
                if left:
                    self.expected_pasts[authority] = left
                else:
                    del self.expected_pasts[authority]
            self.waiters.wake_all()

        return end


class ExpiredLookups:
    """Counts lookups older than the cache in `count`; `missed_by_ns` is the largest distance to
    the oldest sample. Of `mistaken` ones the stamp was in another unit, 0 or of another clock, as
    the sentence `mistake` says of the last.
    """

    def __init__(self, cache_time_s: float) -> None:
        self._cache_time_s = cache_time_s
        self.count = 0
        self.missed_by_ns = self.mistaken = 0
        self.mistake = ""

    def record(self, error: TransformException | None) -> None:
        """Count a lookup that failed so, if a longer cache would have had the answer, or if none
        would, as its stamp is a mistake.
        """
        if not isinstance(error, PastExtrapolationException | SingleSampleException):
            return
        asked_ns, oldest_ns, newest_ns = error.requested_ns, error.oldest_ns, error.newest_ns
        if asked_ns is None or oldest_ns is None or newest_ns is None or asked_ns > oldest_ns:
            return
        if mistake := mistake_of(asked_ns, newest_ns):
            self.mistaken += 1
            self.mistake = "; ".join(filter(None, (mistake.fact, mistake.advice)))
        elif newest_ns - oldest_ns > _FULL * self._cache_time_s * 1e9:
            self.count += 1
            self.missed_by_ns = max(self.missed_by_ns, oldest_ns - asked_ns)
