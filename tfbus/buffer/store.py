"""The state of a buffer behind one lock, and who is notified when it changes.

Compiled if there is a C compiler (`store.pxd` has the C types).
"""

import logging
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress

from tfbus.buffer.explain import unknown_frame
from tfbus.buffer.info import Change, ExpiredLookups, Rejections
from tfbus.buffer.insert_many import BatchInserter
from tfbus.buffer.lock import Lock
from tfbus.buffer.tree import Tree
from tfbus.buffer.waiting import Question, Waiters
from tfbus.core.kernel import LONGEST_NS, Path
from tfbus.core.sampling import TF2, Sampling
from tfbus.errors import LookupException, TransformException
from tfbus.geometry.transform import TransformStamped, child_name
from tfbus.runtime.log import LogOnce
from tfbus.wording import printable

# Gets each pair of frames that is looked up; and explains, if it can, why one has no answer.
QuestionWatcher = tuple[
    Callable[[str, str], object], Callable[[str, str], "TransformException | None"]
]

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
        """The error of a frame that is unknown or not connected, or the better one of a watcher."""
        if self._watchers:
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
