"""What a buffer knows, behind its lock, and who is told of what happens to it.

One of the modules that are compiled where there is a C compiler (`store.pxd` says the C types).
"""

import logging
import threading
from collections.abc import Callable, Iterable
from contextlib import suppress

from tfbus.buffer.change import Change
from tfbus.buffer.expired_lookups import Shortfall
from tfbus.buffer.insert_many import Intake
from tfbus.buffer.rejections import Rejections
from tfbus.buffer.tree import Tree
from tfbus.buffer.waiting import Waiters
from tfbus.core.kernel import Path
from tfbus.core.outcome import LONGEST_NS
from tfbus.core.sampling import TF2, Sampling
from tfbus.errors import InvalidArgumentException, TransformException
from tfbus.geometry.batch import TransformBatch
from tfbus.geometry.columns import Columns
from tfbus.geometry.transform import TransformStamped
from tfbus.runtime.clock import SYSTEM_CLOCK

try:
    import cython
except ImportError:
    from tfbus.core import cython_stub as cython

# Told which frames are asked for; and explains why one of them is not there yet, if it can.
Reader = tuple[Callable[[str, str], object], Callable[[str, str], TransformException | None]]

_log = logging.getLogger(__name__)


class Store:
    """The tree of frames, filled from any thread; the lowest part of `Buffer`, which says more.

    The lock is held for one transform, or for the rows of one batch, and never while others are
    told.
    """

    def __init__(
        self,
        cache_time_s: float = 10.0,
        *,
        sampling: Sampling = TF2,
        clock: Callable[[], int] = SYSTEM_CLOCK,
    ) -> None:
        if not cache_time_s >= 0.0:
            raise InvalidArgumentException(
                f"cache_time_s is {cache_time_s!r}; it is a number of seconds, 0 or more"
            )
        if not cython.compiled:
            # Compiled, it is a mutex of C.
            self._lock = threading.Lock()
        self.cache_time_s = cache_time_s
        self.sampling = TF2 if sampling == TF2 else sampling
        self.clock = clock
        self.rejected = Rejections()
        self.shortfall = Shortfall()
        self._tree = Tree(round(min(cache_time_s * 1e9, LONGEST_NS)))
        self._intake = Intake(self._tree, self.rejected)
        self._waiters = Waiters(self._tree)
        self._listeners: list[Callable[[Change], None]] = []
        self._readers: list[Reader] = []
        self._expected_pasts: dict[str, int] = {}

    # Filling it

    def set_transform(
        self, transform: TransformStamped, *, static: bool = False, authority: str = ""
    ) -> bool:
        """Take one transform; a static one holds at all times.

        False where it is older than the newest of its child frame by more than the cache time.
        One that repeats a stamp replaces the former; where it differs, that is a conflict, which
        is counted and told to listeners. Raises InvalidArgumentException for a frame that is its
        own parent, LoopException for an edge that would close a loop; then nothing has changed.
        """
        with self._lock:
            taken = self._insert_one(transform, static, authority)
        if self._tree.touched or self._tree.news or self._tree.untold:
            self._announce()
        return taken

    def set_transforms(
        self, batch: TransformBatch | Columns, *, static: bool = False, authority: str = ""
    ) -> int:
        """Take the rows of a batch; how many were taken.

        A row that cannot be taken harms none of the others: it is counted in `rejected`, by its
        reason.
        """
        columns = batch if isinstance(batch, Columns) else Columns.of_batch(batch)
        with self._lock:
            taken = self._intake.take(columns, static, authority)
        if self._tree.touched or self._tree.news or self._tree.untold:
            self._announce()
        return taken

    def clear(self, *, after_ns: int | None = None) -> None:
        """Forget all samples, or those later than a time where it is given; static transforms
        stay, and so do the names of all frames.

        A frame that has changed its parent of late, and has samples later than the time, loses
        its earlier ones, too.
        """
        with self._lock:
            if after_ns is None:
                self._tree.clear()
            else:
                self._tree.clear_after(after_ns)
        self._waiters.wake_all()

    # What a listener learns about who sends them

    def sent_by(self, authority: str) -> dict[str, int]:
        """The frames whose last transform this authority sent, and how many samples of each are
        held; of a static transform none is counted.
        """
        with self._lock:
            return self._tree.sent_by(authority)

    def forget(self, authority: str, frames: Iterable[str] | None = None) -> None:
        """Forget the samples of the frames that this authority sent last, as it begins anew;
        static transforms stay. With `frames` only of these.
        """
        with self._lock:
            self._tree.forget(authority, frames)
        self._waiters.wake_all()

    def mark_gone(self, frames: Iterable[str], gone: bool, authority: str) -> None:
        """Note that the publisher of those of the frames that it sent last is gone, or back."""
        with self._lock:
            self._tree.mark_gone(frames, gone, authority)
        self._announce()

    def remove_sent(self, frames: Iterable[str], authority: str) -> None:
        """Remove those of the frames that this authority sent last, as `remove` does."""
        with self._lock:
            for frame in frames:
                self._tree.remove_sent(frame, authority)
        self._waiters.wake_all()
        self._announce()

    def tell(self, change: Change) -> None:
        """Tell those who listen for changes of one that was noticed elsewhere."""
        with self._lock:
            if self._tree.news is not None:
                self._tree.news.append(change)
        self._announce()

    # Who is told

    def on_change(self, listener: Callable[[Change], None]) -> Callable[[], None]:
        """Call the listener with each change from now on; call what it returns to end that.

        It is called in the thread that inserts, without the lock, one change after another; it
        may use the buffer. What it raises is logged.
        """
        with self._lock:
            self._listeners = [*self._listeners, listener]
            if self._tree.news is None:
                self._tree.news = []

        def end() -> None:
            with self._lock:
                with suppress(ValueError):
                    others = list(self._listeners)
                    others.remove(listener)
                    self._listeners = others
                if not self._listeners:
                    self._tree.news = None

        return end

    def watch_questions(
        self,
        callback: Callable[[str, str], object],
        explain: Callable[[str, str], TransformException | None] = lambda target, source: None,
    ) -> Callable[[], None]:
        """Call `callback(target, source)` once for each pair of frames that is asked for from now
        on; call what is returned to end that.

        It is called without the lock, in the thread that asks and before a lookup waits. A pair
        that can be answered at once is told at the next insert, or the next lookup that cannot
        be answered; so the others pay nothing for it. Where frames are unknown or not connected,
        `explain(target, source)` may give the error that says it better.
        """
        reader = (callback, explain)
        with self._lock:
            self._readers = [*self._readers, reader]
            self._tree.asked = set()
            self._tree.topology += 1

        def end() -> None:
            with self._lock:
                self._readers = [each for each in self._readers if each is not reader]
                if not self._readers:
                    self._tree.asked = None

        return end

    def ask_again(self) -> None:
        """Call those who watch questions once more for each pair, when it is asked for next;
        for those that wait in a lookup that is now.
        """
        with self._lock:
            self._tree.ask_again()
        self._waiters.wake_all()

    def expect_past(self, authority: str) -> Callable[[], None]:
        """Have lookups with a timeout wait for a time before the first sample of a frame that this
        authority sent last; until what is returned is called, when what was to come has come.
        """
        with self._lock:
            self._expected_pasts[authority] = self._expected_pasts.get(authority, 0) + 1

        def end() -> None:
            with self._lock:
                left = self._expected_pasts[authority] - 1
                if left:
                    self._expected_pasts[authority] = left
                else:
                    del self._expected_pasts[authority]
            self._waiters.wake_all()

        return end

    @property
    def waiting(self) -> int:
        """How many lookups wait in it now."""
        return len(self._waiters)

    # The rest is not for users

    def _insert_one(self, transform: TransformStamped, static: bool, authority: str) -> bool:
        return self._tree.insert(
            transform._frame_id,
            transform._child_frame_id,
            transform._stamp_ns,
            transform._pose,
            static,
            authority,
        )

    def _ask_path(self, target_frame: str, source_frame: str) -> Path | None:
        with self._lock:
            return self._tree.path(target_frame, source_frame)

    def _announce(self) -> None:
        """Wake those who wait, and tell those who listen; without the lock."""
        tree = self._tree
        with self._lock:
            touched, moved, news = tree.touched, tree.moved, tree.news
            if touched is not None:
                tree.touched, tree.moved = [], []
            if news is not None:
                tree.news = []
            spans = [(history, history.stamp_span()) for history in touched or ()]
            listeners = self._listeners
        if spans or moved:
            self._waiters.notify(spans, moved or ())
        for change in news or ():
            for listener in listeners:
                try:
                    listener(change)
                except Exception:
                    _log.exception("a listener of changes failed")
        if tree.untold:
            self._tell_questions()

    def _tell_questions(self) -> None:
        """Tell those who watch which pairs were asked for; without the lock."""
        with self._lock:
            untold, self._tree.untold = self._tree.untold, []
            readers = self._readers
        for target_frame, source_frame in untold:
            for callback, _ in readers:
                try:
                    callback(target_frame, source_frame)
                except Exception:
                    _log.exception("a watcher of questions failed")
