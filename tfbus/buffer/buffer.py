"""The buffer: the last seconds of every frame, and the transform between any two at any time.

Compiled if there is a C compiler (`buffer.pxd` has the C types).
"""

from __future__ import annotations

import math
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from itertools import islice
from typing import TYPE_CHECKING, Any

from tfbus.base.arguments import SourceSignature, check_plain, is_async
from tfbus.base.clock import SYSTEM_CLOCK
from tfbus.base.errors import (
    ExtrapolationException,
    InvalidArgumentException,
    TransformException,
)
from tfbus.base.installation import InterpretedWarning, why_interpreted, why_not_installed
from tfbus.buffer.explain import Freshness, check_seconds, without_timeout
from tfbus.buffer.info import Change, Rejections
from tfbus.buffer.info import FrameInfo as FrameInfo
from tfbus.buffer.insert_many import Permit
from tfbus.buffer.lookup import Lookup, check_sampling, lookup_many
from tfbus.buffer.store import ExpiredLookups, Store
from tfbus.geometry.batch import TransformBatch
from tfbus.geometry.columns import Columns, columns_of_batch
from tfbus.geometry.kernel import ALL_STATIC, LONGEST_NS, NO_DATA
from tfbus.geometry.sampling import TF2, Contents, Held, Sampling
from tfbus.geometry.transform import (
    TransformStamped,
    check_frame_id,
    check_stamp,
    check_text,
    make_stamped,
)

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import ArrayLike, NDArray

    # These are imported where they are used, which few processes do: a process is to start soon.
    from tfbus.geometry.transform_array import TransformArray
    from tfbus.geometry.twist import TwistStamped
else:
    from tfbus.base import lazy_numpy as np

try:
    import cython
except ImportError:
    from tfbus.base import cython_stub as cython

# Frames that are removed, or looked at, at a time: some 100 microseconds.
_FRAMES_AT_A_TIME = 256

# The timeout of a lookup that names none: compiled, equal numbers of a module are one object, so
# that the default needs no further check.
_AT_ONCE = 0.0

# Samples of a frame a second of the cache, and the fewest in all: 10 kHz for ten seconds.
_SAMPLES_A_SECOND = 10_000
_LEAST_SAMPLES = 100_000

# The attributes of an interpreted buffer itself, without a subclass's.
_ATTRIBUTES = ("cache_time_s", "sampling", "_store")

# Whether the buffer is compiled, or interpreted.
COMPILED: bool = cython.compiled

if not COMPILED:
    if _mistake := why_not_installed():
        warnings.warn(_mistake, RuntimeWarning, stacklevel=2)
    elif _mistake := why_interpreted():
        warnings.warn(_mistake, InterpretedWarning, stacklevel=2)


class Buffer:
    """The transforms of the last `cache_time_s` seconds, by their own stamps; math.inf keeps all.

    A lookup follows the edges between two frames, at one time. Semantics are tf2's unless
    `sampling` says otherwise.

    Safe from any thread. One lock is held for one lookup, or for the rows of one batch, of which at
    most 256 bring new frames; a lookup with a timeout sleeps without it.

    A signal handler or finalizer may use the buffer in the middle of a call of the same thread:
    lookups answer at once, and inserts and removals are done when the interrupted call ends.

    `clock` returns the time for the age of samples. If it is simulated (`node.clock`), timeouts are
    in simulated seconds. A TransformListener sets it to its node's, unless the buffer has another.

    Of one frame at most `max_samples` are kept: then the oldest gives way, `FrameInfo.crowded_out`
    counts it, and the first is logged. None is 10,000 for each second of `cache_time_s`, at least
    100,000.

    Raises InvalidArgumentException for a `cache_time_s` below 0, and for `max_samples` below 1.
    """

    __signature__ = SourceSignature()

    def __cinit__(self, *_: object, **named: object) -> None:
        # As in tf2; a subclass may have such an argument.
        if "cache_time" in named and type(self) is Buffer:
            raise TypeError("a Buffer has no cache_time; call it as in Buffer(cache_time_s=10.0)")
        # A subclass may forget to call `super().__init__()`: then it has the defaults.
        self._fill(10.0, TF2, SYSTEM_CLOCK, default_max_samples(10.0))

    def __init__(
        self,
        cache_time_s: float = 10.0,
        *,
        sampling: Sampling = TF2,
        clock: Callable[[], int] = SYSTEM_CLOCK,
        max_samples: int | None = None,
    ) -> None:
        check_seconds(cache_time_s, "cache_time_s")
        check_sampling(sampling)
        _check_clock(clock)
        if max_samples is None:
            max_samples = default_max_samples(cache_time_s)
        if not isinstance(max_samples, int) or max_samples < 1:
            raise InvalidArgumentException(
                f"max_samples must be a whole number of samples, 1 or more, not {max_samples!r}"
            )
        self._fill(cache_time_s, sampling, clock, max_samples)

    def _fill(
        self,
        cache_time_s: float,
        sampling: Sampling,
        clock: Callable[[], int],
        max_samples: int,
    ) -> None:
        self.cache_time_s = cache_time_s
        self._store = Store(cache_time_s, sampling, clock, min(max_samples, 2**62))
        self.sampling = self._store.sampling

    @property
    def clock(self) -> Callable[[], int]:
        """Returns the time in nanoseconds since the Unix epoch; can be set."""
        return self._store.clock

    @clock.setter
    def clock(self, clock: Callable[[], int]) -> None:
        _check_clock(clock)
        self._store.clock = clock

    @property
    def rejected(self) -> Rejections:
        """Counts the rows of batches that were not stored, by reason."""
        return self._store.rejected

    @property
    def expired_lookups(self) -> ExpiredLookups:
        """Counts lookups older than the cache."""
        return self._store.expired_lookups

    @property
    def waiting(self) -> int:
        """How many lookups wait in it now."""
        return len(self._store.waiters)

    # Filling it

    def set_transform(
        self, transform: TransformStamped, *, static: bool = False, authority: str = ""
    ) -> bool:
        """Store one transform; a static one holds at all times.

        Returns False if it is older than the newest of its child frame by more than the cache time.
        Of equal stamps the last counts; if the two differ, that is a conflict, which is passed to
        `on_change`. Raises InvalidArgumentException for a frame that is its own parent,
        LoopException for an edge that would close a loop.
        """
        if not isinstance(transform, TransformStamped):
            raise InvalidArgumentException(
                f"transform: expected a tfbus.TransformStamped, got a {type(transform).__name__}"
            )
        if type(authority) is not str:
            authority = check_text(authority, "authority")
        lock = self._store.lock
        if not lock.enter():
            lock.leave()
            lock.later(self.set_transform, transform, static=static, authority=authority)
            return True
        try:
            stored = self._store.insert(transform, static, authority)
        finally:
            lock.leave()
        tree = self._store.tree
        if tree.touched or tree.news or tree.unreported or tree.crowded:
            self._store.notify()
        return stored

    def set_transforms(
        self,
        batch: TransformBatch | Columns | Iterable[TransformStamped],
        *,
        static: bool = False,
        authority: str = "",
        permit: Permit | None = None,
    ) -> int:
        """Store the rows of a batch, or several TransformStamped; returns how many were stored.

        A row that cannot be stored is counted in `rejected`, by its reason. With a `permit`, which
        another thread may take back, rows are stored only while it is valid.
        """
        columns = batch if isinstance(batch, Columns) else _columns(batch)
        if type(authority) is not str:
            authority = check_text(authority, "authority")
        lock = self._store.lock
        if not lock.enter():
            lock.leave()
            lock.later(
                self.set_transforms, columns, static=static, authority=authority, permit=permit
            )
            return len(columns)
        try:
            stored = self._store.inserter.insert(columns, static, authority, permit)
        finally:
            lock.leave()
        tree = self._store.tree
        if tree.touched or tree.news or tree.unreported or tree.crowded:
            self._store.notify()
        return stored

    def clear(self, *, after_ns: int | None = None) -> None:
        """Forget all samples, or only the ones later than `after_ns`; static transforms stay, and
        so do the names of all frames.

        A frame whose parent has changed within the cache time, and that has samples later than
        `after_ns`, loses its earlier ones, too.
        """
        after_ns = _stamp(after_ns)
        if self._store.lock.later(self.clear, after_ns=after_ns):
            return
        with self._store.lock:
            if after_ns is None:
                self._store.tree.clear()
            else:
                self._store.tree.clear_after(after_ns)
        self._store.waiters.wake_all()

    def interrupt(self, reason: str) -> None:
        """Note that from now on, until the next sample of each frame, nothing is known, as while a
        recorder is paused: a lookup between the two samples of an edge raises
        ExtrapolationException with this reason. Static frames are not concerned.
        """
        reason = check_text(reason, "reason")
        if self._store.lock.later(self.interrupt, reason):
            return
        with self._store.lock:
            self._store.tree.interrupt(reason)

    def remove(self, frame: str) -> None:
        """Forget a frame's place in its parent, static or not, and its history.

        Frames below it stay, and it stays as their root. Raises LookupException for an unknown
        frame.
        """
        frame = check_text(frame, "frame")
        if self._store.lock.later(self.remove, frame):
            return
        known = False
        with self._store.lock:
            known = self._store.tree.remove(frame)
        if not known:
            raise self._store.unknown_frame(frame)
        self._store.waiters.wake_all()
        if self._store.tree.news:
            self._store.notify()

    # A listener's reports of publishers

    def sent_by(self, authority: str) -> dict[str, int]:
        """The frames whose last transform this authority sent, and how many samples of each are
        held, of a static one 0.
        """
        authority = check_text(authority, "authority")
        held: dict[str, int] = {}
        for some in self._in_slices(self._frames_of(authority)):
            with self._store.lock:
                held |= self._store.tree.sent_by(authority, some)
        return held

    def count_sent_by(self, authority: str) -> int:
        """How many frames this authority sent last."""
        return len(self._store.tree.senders.get(authority, ()))

    def known_frame(self, name: str) -> FrameInfo | None:
        """The state of one frame, as `frame`; None if it is unknown, which copies no names."""
        name = check_text(name, "name")
        with self._store.lock:
            return self._store.tree.info(name)

    def senders_of(self, frames: Iterable[str]) -> dict[str, set[str]]:
        """These frames by the authority that sent each last; unknown ones are left out."""
        senders: dict[str, set[str]] = {}
        for some in self._in_slices(frames):
            with self._store.lock:
                for frame in some:
                    history = self._store.tree.frames.get(frame)
                    if history is not None and history.parent is not None:
                        senders.setdefault(history.authority, set()).add(frame)
        return senders

    def forget(self, authority: str, frames: Iterable[str] | None = None) -> None:
        """Forget the samples of the frames that this authority sent last, because it restarted;
        static transforms stay. With `frames` only of these.
        """
        authority = check_text(authority, "authority")
        if self._store.lock.later(self.forget, authority, frames):
            return
        for some in self._in_slices(self._frames_of(authority) if frames is None else frames):
            with self._store.lock:
                self._store.tree.forget(authority, some)
        self._store.waiters.wake_all()

    def mark_gone(self, frames: Iterable[str], gone: bool, authority: str) -> None:
        """Mark the frames that this authority sent last: their publisher is gone, or back."""
        authority = check_text(authority, "authority")
        if self._store.lock.later(self.mark_gone, frames, gone, authority):
            return
        for some in self._in_slices(frames):
            with self._store.lock:
                self._store.tree.mark_gone(some, gone, authority)
            self._store.notify()

    def remove_sent(self, frames: Iterable[str], authority: str) -> None:
        """Remove the frames that this authority sent last, as `remove` does."""
        authority = check_text(authority, "authority")
        if self._store.lock.later(self.remove_sent, frames, authority):
            return
        for some in self._in_slices(frames):
            with self._store.lock:
                for frame in some:
                    self._store.tree.remove_sent(check_text(frame, "frame"), authority)
            self._store.notify()
        self._store.waiters.wake_all()

    def _frames_of(self, authority: str) -> list[str]:
        with self._store.lock:
            return list(self._store.tree.senders.get(authority, ()))

    def _in_slices(self, frames: Iterable[str]) -> Iterator[list[str]]:
        """The frames, a few at a time: other threads look up between them."""
        left = iter(frames)
        while some := list(islice(left, _FRAMES_AT_A_TIME)):
            yield some
            # Other threads run meanwhile, even where no listener is called.
            with cython.nogil:
                pass

    def expect_past(self, authority: str) -> Callable[[], None]:
        """Let lookups with a timeout wait for times before the first sample of a frame that this
        authority sent last; call the returned function when the past has arrived.
        """
        return self._store.expect_past(authority)

    def expect_no_more(self) -> None:
        """Note that no further data will come, as for a buffer of a file: errors then advise no
        waiting.
        """
        self._store.is_ended = True

    # Notifying

    def on_change(self, listener: Callable[[Change], None]) -> Callable[[], None]:
        """Call the listener with each change from now on; the returned function ends that.

        It is called in the thread that inserts, without the lock, one change after another; it
        may use the buffer. Its exceptions are logged.
        """
        if not callable(listener):
            raise InvalidArgumentException(
                f"listener must be a function of a tfbus.Change, not {type(listener).__name__}"
            )
        check_plain("on_change(listener)", listener)
        return self._store.on_change(listener)

    def announce(self, change: Change) -> None:
        """Pass a change that was noticed elsewhere to the listeners of `on_change`."""
        if self._store.lock.later(self.announce, change):
            return
        with self._store.lock:
            if self._store.tree.news is not None:
                self._store.tree.news.append(change)
        self._store.notify()

    def watch_questions(
        self,
        callback: Callable[[str, str], object],
        explain: Callable[[str, str], TransformException | None] = lambda target, source: None,
    ) -> Callable[[], None]:
        """Call `callback(target, source)` once for each pair of frames that is looked up from now
        on; the returned function ends that.

        It is called without the lock, in the thread that looks up and before it waits. A pair that
        can be answered at once is reported at the next insert, or the next lookup that cannot be
        answered; so other lookups stay as fast. If frames are unknown or not connected,
        `explain(target, source)` may return a better error.
        """
        for each in (callback, explain):
            check_plain("watch_questions(callback, explain)", each)
        return self._store.watch_questions(callback, explain)

    def ask_again(self) -> None:
        """Call the callbacks of `watch_questions` once more for each pair, at its next lookup; for
        waiting lookups at once.
        """
        if self._store.lock.later(self.ask_again):
            return
        with self._store.lock:
            self._store.tree.ask_again()
        self._store.waiters.wake_all()

    # Looking up

    def lookup_transform(
        self,
        target_frame: str,
        source_frame: str,
        stamp_ns: int | None = None,
        *,
        timeout_s: float = 0.0,
        sampling: Sampling | None = None,
        max_age_s: float | None = None,
        living: bool = False,
    ) -> TransformStamped:
        """The transform that takes data in `source_frame` into `target_frame`.

        This is the pose of the source seen from the target. The stamp None means the latest time
        for which every edge between the two has data, 0 if all are static.

        Waits at most `timeout_s` for data that may still arrive. Raises InvalidArgumentException
        for a malformed name, LookupException for an unknown frame, ConnectivityException if no path
        joins the two, a kind of ExtrapolationException for a stamp outside the samples, and
        TimeoutException, with the reason, after waiting.

        Raises StaleException if the newest sample of a dynamic edge is older than `max_age_s`, or,
        with `living`, if the publisher of an edge is gone.
        """
        if timeout_s is not _AT_ONCE and (
            not (type(timeout_s) is float or type(timeout_s) is int) or timeout_s != timeout_s
        ):
            check_seconds(timeout_s, "timeout_s", least=-math.inf)
        # Nearly every lookup is one of these: nothing is made for it but its answer.
        if (
            cython.compiled
            and type(target_frame) is str
            and type(source_frame) is str
            and (stamp_ns is None or type(stamp_ns) is int)
            and sampling is None
            and max_age_s is None
            and living is False
        ):
            return self._lookup_plain(target_frame, source_frame, stamp_ns, timeout_s)
        return self._lookup(
            target_frame, source_frame, stamp_ns, timeout_s, sampling, max_age_s, living
        )

    def _lookup_plain(
        self, target_frame: str, source_frame: str, stamp_ns: int | None, timeout_s: float
    ) -> TransformStamped:
        """Compiled: `lookup_transform` of plain arguments, without the lock if it is free."""
        if self.sampling is TF2:
            answer = TransformStamped.__new__(TransformStamped)
            # Nothing of Python runs from here on: the lock stays free.
            if self._store.lock.is_free() and self._store.tree.fill(  # type: ignore[attr-defined]
                answer, target_frame, source_frame, stamp_ns
            ):
                return answer
        question = (target_frame, source_frame, stamp_ns)
        answered: TransformStamped = Lookup(self._store, (question,)).wait(timeout_s)[0]
        return answered

    def _lookup(
        self,
        target_frame: str,
        source_frame: str,
        stamp_ns: int | None,
        timeout_s: float,
        sampling: Sampling | None,
        max_age_s: float | None,
        living: bool,
    ) -> TransformStamped:
        """`lookup_transform` of any arguments."""
        # A value of another type may have no hash, or its own.
        if type(target_frame) is not str:
            target_frame = check_frame_id(target_frame, "target_frame")
        if type(source_frame) is not str:
            source_frame = check_frame_id(source_frame, "source_frame")
        if stamp_ns is not None and type(stamp_ns) is not int:
            stamp_ns = check_stamp(stamp_ns)
        if sampling is not None:
            check_sampling(sampling)
        if max_age_s is None and not living:
            answer = self._answer(target_frame, source_frame, stamp_ns, sampling)
            if answer is not None:
                return answer
        question = (target_frame, source_frame, stamp_ns)
        fresh = _freshness(max_age_s, living)
        return Lookup(self._store, (question,), sampling, fresh).wait(timeout_s)[0]

    def _answer(
        self,
        target_frame: str,
        source_frame: str,
        stamp_ns: int | None,
        sampling: Sampling | None,
    ) -> TransformStamped | None:
        """The answer of this moment; None without one."""
        self._store.lock.enter()
        try:
            return self._store.tree.answer(
                target_frame,
                source_frame,
                stamp_ns,
                self.sampling if sampling is None else sampling,
            )
        finally:
            self._store.lock.leave()

    def lookup_transform_full(
        self,
        target_frame: str,
        target_stamp_ns: int | None,
        source_frame: str,
        source_stamp_ns: int | None,
        fixed_frame: str,
        *,
        timeout_s: float = 0.0,
        sampling: Sampling | None = None,
    ) -> TransformStamped:
        """The source as it was at one time, seen from the target at another.

        `fixed_frame` must not move between the two times. The answer has the target's stamp.
        Waits and raises as `lookup_transform`.
        """
        questions = (
            (fixed_frame, source_frame, _stamp(source_stamp_ns)),
            (target_frame, fixed_frame, _stamp(target_stamp_ns)),
        )
        return _joined(Lookup(self._store, questions, sampling).wait(timeout_s))

    def can_transform(
        self,
        target_frame: str,
        source_frame: str,
        stamp_ns: int | None = None,
        *,
        timeout_s: float = 0.0,
        sampling: Sampling | None = None,
        max_age_s: float | None = None,
        living: bool = False,
    ) -> bool:
        """Whether `lookup_transform` with the same arguments would succeed."""
        check_seconds(timeout_s, "timeout_s", least=-math.inf)
        question = (target_frame, source_frame, _stamp(stamp_ns))
        fresh = _freshness(max_age_s, living)
        lookup = Lookup(self._store, (question,), sampling, fresh)
        if timeout_s <= 0.0:
            return lookup.answers() is not None
        try:
            lookup.wait(timeout_s)
        except TransformException:
            return False
        return True

    async def wait_for_transform(
        self,
        target_frame: str,
        source_frame: str,
        stamp_ns: int | None = None,
        *,
        timeout_s: float | None = None,
        sampling: Sampling | None = None,
        max_age_s: float | None = None,
        living: bool = False,
    ) -> TransformStamped:
        """The answer of `lookup_transform` as soon as there is one, for asyncio.

        Raises TimeoutException after `timeout_s` (None: never), and other errors at once if
        waiting does not help. Cancel it like any task.
        """
        question = (target_frame, source_frame, _stamp(stamp_ns))
        lookup = Lookup(self._store, (question,), sampling, _freshness(max_age_s, living))
        return (await lookup.wait_async(timeout_s))[0]

    async def wait_for_transform_full(
        self,
        target_frame: str,
        target_stamp_ns: int | None,
        source_frame: str,
        source_stamp_ns: int | None,
        fixed_frame: str,
        *,
        timeout_s: float | None = None,
        sampling: Sampling | None = None,
    ) -> TransformStamped:
        """The answer of `lookup_transform_full` as soon as there is one, for asyncio."""
        questions = (
            (fixed_frame, source_frame, _stamp(source_stamp_ns)),
            (target_frame, fixed_frame, _stamp(target_stamp_ns)),
        )
        return _joined(await Lookup(self._store, questions, sampling).wait_async(timeout_s))

    def latest_common_time(self, target_frame: str, source_frame: str) -> int | None:
        """The latest stamp for which every edge between the two frames has data.

        None if all of them are static. Raises as `lookup_transform`.
        """
        latest = NO_DATA
        with self._store.lock:
            path = self._store.tree.path(target_frame, source_frame)
            latest = NO_DATA if path is None else path.latest()
        if latest == NO_DATA:
            raise Lookup(self._store, ((target_frame, source_frame, None),)).error()
        return None if latest == ALL_STATIC else latest

    # Looking up many

    def lookup_transforms(
        self,
        target_frame: str,
        source_frame: str,
        stamps_ns: ArrayLike,
        *,
        sampling: Sampling | None = None,
    ) -> TransformArray:
        """The transforms at N stamps (N,): a sequence of N, whose arrays are `xyz` (N, 3) in metres
        and `quat_xyzw` (N, 4).

        Raises as `lookup_transform` if one of the stamps cannot be answered.
        """
        stamps = _stamps(stamps_ns)
        answers, known = self.lookup_known_transforms(
            target_frame, source_frame, stamps, sampling=sampling
        )
        if not known.all():
            first = int(stamps[np.argmin(known)])
            error = Lookup(self._store, ((target_frame, source_frame, first),), sampling).error()
            raise without_timeout(error, many=True)
        return answers

    def lookup_known_transforms(
        self,
        target_frame: str,
        source_frame: str,
        stamps_ns: ArrayLike,
        *,
        sampling: Sampling | None = None,
    ) -> tuple[TransformArray, NDArray[np.bool_]]:
        """The transforms at N stamps as far as they are known, and a mask of the known stamps.

        The mask (N,) is False, and the rows are NaN, if the stamp is out of range. Raises
        LookupException for an unknown frame, ConnectivityException if no path joins the two at
        any of the stamps.
        """
        from tfbus.geometry.transform_array import make_array

        xyz, quat_xyzw, known = lookup_many(
            self._store,
            target_frame,
            source_frame,
            _stamps(stamps_ns),
            self.sampling if sampling is None else check_sampling(sampling),
        )
        return make_array(xyz, quat_xyzw), known

    def transform_points(
        self,
        points: ArrayLike,
        target_frame: str,
        source_frame: str,
        stamps_ns: ArrayLike | None = None,
        *,
        target_stamp_ns: int | None = None,
        fixed_frame: str | None = None,
        sampling: Sampling | None = None,
    ) -> NDArray[np.float64]:
        """Points (N, 3) of the source frame, transformed into the target frame.

        `stamps_ns` is one stamp, or one for each point (N,); None means the latest. With a
        `fixed_frame` all points are transformed into the target as it was at `target_stamp_ns`
        (None: the latest), which undistorts a lidar scan. Raises as `lookup_transform`, and
        InvalidArgumentException for a `target_stamp_ns` without a `fixed_frame`.
        """
        if isinstance(points, str):
            raise InvalidArgumentException(
                "the points come first: "
                "transform_points(points, target_frame, source_frame, stamps_ns)"
            )
        try:
            array = np.asarray(points, dtype=np.float64)
        except (TypeError, ValueError):
            raise InvalidArgumentException(
                f"points: expected numbers of shape (N, 3), got {points!r:.100}"
            ) from None
        if array.ndim != 2 or array.shape[1] != 3:
            raise InvalidArgumentException(f"points: expected shape (N, 3), got {array.shape}")
        if target_stamp_ns is not None and fixed_frame is None:
            raise InvalidArgumentException(
                "target_stamp_ns needs fixed_frame, the frame that does not move between the times "
                "of the points and that of the target"
            )
        if fixed_frame is not None:
            into = self._lookup_at_once(target_frame, fixed_frame, target_stamp_ns, sampling)
            fixed = self.transform_points(
                array, fixed_frame, source_frame, stamps_ns, sampling=sampling
            )
            return into.transform.apply(fixed)
        if stamps_ns is None or np.ndim(stamps_ns) == 0:
            stamp = None if stamps_ns is None else check_stamp(stamps_ns)
            whole = self._lookup_at_once(target_frame, source_frame, stamp, sampling)
            return whole.transform.apply(array)
        stamps = _stamps(stamps_ns)
        if len(stamps) != len(array):
            raise InvalidArgumentException(
                f"{len(array)} points but {len(stamps)} stamps: each point needs one"
            )
        return self.lookup_transforms(target_frame, source_frame, stamps, sampling=sampling).apply(
            array
        )

    def transform(
        self,
        message: Any,
        target_frame: str,
        *,
        fixed_frame: str | None = None,
        timeout_s: float = 0.0,
    ) -> Any:
        """A message of `tfbus.messages` in the target frame, by the transform at its stamp; a stamp
        of 0 stands for the latest.

        PointCloud (with normals), PointStamped, PolygonStamped, PoseStamped, PoseArray, Path,
        PoseWithCovarianceStamped, Odometry (its pose), Imu, OccupancyGrid (its origin), Marker and
        MarkerArray stay of their type; a LaserScan becomes a PointCloud, NaN for no measurement. If
        points have a time each, each is moved by the transform at that, and is then as of the
        stamp: say the `fixed_frame` if the target itself moves meanwhile. Covariances of x, y, z
        and rotations about fixed axes turn to the target's axes; unknown ones stay so. Waits and
        raises as `lookup_transform`, and InvalidArgumentException for a message of another type.
        """
        from tfbus.buffer.messages import Lookups, transformed

        at_stamp = partial(self.lookup_transform, timeout_s=timeout_s)
        lookups = Lookups(at_stamp, self.lookup_transforms)
        return transformed(lookups, message, target_frame, fixed_frame)

    def _lookup_at_once(
        self,
        target_frame: str,
        source_frame: str,
        stamp_ns: int | None,
        sampling: Sampling | None = None,
    ) -> TransformStamped:
        """As `lookup_transform`, for a caller without a timeout, which its errors do not name."""
        try:
            return self.lookup_transform(target_frame, source_frame, stamp_ns, sampling=sampling)
        except ExtrapolationException as error:
            raise without_timeout(error) from None

    def lookup_twist(
        self,
        frame: str,
        reference_frame: str,
        stamp_ns: int | None = None,
        *,
        observation_frame: str | None = None,
        window_s: float = 0.1,
    ) -> TwistStamped:
        """The velocity of `frame` relative to `reference_frame`: linear in m/s, angular in rad/s.

        Both are in the axes of `observation_frame` (by default the reference) at that time,
        estimated from the samples in a window of `window_s` around the stamp (None: the latest
        common time), shifted to the samples that there are. Exact for a line, a circle or a screw
        at constant speed. Raises as `lookup_transform`.
        """
        from tfbus.geometry.twist import TwistStamped, fit_twist, pick_stamps

        check_seconds(window_s, "window_s", least=1e-9, most=LONGEST_NS / 1e9)
        observer = reference_frame if observation_frame is None else observation_frame
        now = self._lookup_at_once(reference_frame, frame, stamp_ns)
        axes = self._lookup_at_once(observer, reference_frame, now.stamp_ns).transform
        with self._store.lock:
            path = self._store.tree.path(reference_frame, frame)
            dynamic = [] if path is None else [h for h in path.edges() if not h.static]
            spans = [history.stamp_span() for history in dynamic]
        if path is None or not all(spans):  # it is forgotten since it was looked up
            error = Lookup(self._store, ((reference_frame, frame, None),)).error()
            raise without_timeout(error)
        if not dynamic:
            still = np.zeros(3)
            stamp = now.stamp_ns
            return TwistStamped(stamp, observer, frame, reference_frame, still, still, stamp, stamp)
        oldest = max(span[0] for span in spans if span)
        newest = min(span[1] for span in spans if span)
        width = round(window_s * 1e9)
        end = min(max(now.stamp_ns, oldest) + width // 2, newest)
        start = max(end - width, oldest)
        if end <= start:
            raise _too_few_for_twist(frame, reference_frame, now.stamp_ns, window_s)
        with self._store.lock:
            sampled = [stamp for h in dynamic for stamp in h.stamps_from(start, end)]
        stamps = pick_stamps(sampled, start, end)
        linear, angular = fit_twist(stamps, self.lookup_transforms(reference_frame, frame, stamps))
        turn = axes @ now.transform
        return TwistStamped(
            now.stamp_ns,
            observer,
            frame,
            reference_frame,
            turn.rotate(linear),
            turn.rotate(angular),
            start,
            end,
        )

    # Copying it

    def __reduce__(self) -> tuple[Any, ...]:
        """A pickle of it: the contents that `files.save` writes. Lookups that wait, listeners and a
        clock stay behind: an unpickled buffer has the system's clock.
        """
        return _unpickled, (type(self), self._contents(), self._store.is_ended), self._own_values()

    def __deepcopy__(self, memo: dict[int, Any]) -> "Buffer":
        """A buffer of its own with the same contents and clock, without listeners."""
        from copy import deepcopy

        copied: Buffer = _unpickled(type(self), self._contents(), self._store.is_ended)
        memo[id(self)] = copied
        copied.clock = self.clock
        for name, value in (self._own_values() or {}).items():
            setattr(copied, name, deepcopy(value, memo))
        return copied

    def _own_values(self) -> dict[str, Any] | None:
        """The attributes that a subclass, or its user, has given it."""
        values = getattr(self, "__dict__", {})
        return {name: value for name, value in values.items() if name not in _ATTRIBUTES} or None

    def _contents(self) -> Contents:
        with self._store.lock:
            held = self._store.tree.held()
        return Contents(self.cache_time_s, self._store.tree.max_samples, self.sampling, held)

    def _restore(self, frames: dict[str, Held]) -> None:
        with self._store.lock:
            self._store.tree.restore(frames)

    # Looking around

    def frames(self) -> list[str]:
        """The names of all frames, sorted."""
        with self._store.lock:
            return sorted(self._store.tree.frames)

    def frame(self, name: str) -> FrameInfo:
        """The state of one frame. Raises LookupException if it is unknown."""
        info = self.known_frame(name)
        if info is None:
            raise self._store.unknown_frame(name)
        return info

    def path(self, target_frame: str, source_frame: str) -> list[str]:
        """The frames from the source to the target, both included, as the tree is now.

        Raises LookupException or ConnectivityException.
        """
        with self._store.lock:
            path = self._store.tree.path(target_frame, source_frame)
            names = [] if path is None else path.names()
        if not names:
            raise Lookup(self._store, ((target_frame, source_frame, None),)).error()
        return names

    def all_frames(self) -> list[FrameInfo]:
        """The state of every frame, sorted by name."""
        with self._store.lock:
            return self._store.tree.infos()

    def _repr_html_(self) -> str:
        from tfbus.buffer.formats import as_html

        return as_html(self.all_frames())

    def _repr_svg_(self) -> str:
        from tfbus.buffer.formats import as_svg

        return as_svg(self.all_frames())

    def __repr__(self) -> str:
        return f"<Buffer of {len(self._store.tree.frames)} frames over {self.cache_time_s:g} s>"


def _unpickled(kind: type[Buffer], contents: Contents, is_ended: bool) -> Buffer:
    """A buffer of a class with these contents, by no `__init__`, as of anything unpickled."""
    limit = contents.max_samples
    buffer = kind.__new__(kind)
    buffer._fill(contents.cache_time_s, contents.sampling, SYSTEM_CLOCK, limit or sys.maxsize)
    buffer._restore(contents.frames)
    if is_ended:
        buffer.expect_no_more()
    return buffer


def default_max_samples(cache_time_s: float) -> int:
    """The samples of a frame that a buffer keeps if nothing else is said."""
    return max(_LEAST_SAMPLES, round(min(cache_time_s, 1e9) * _SAMPLES_A_SECOND))


def _joined(answers: Sequence[TransformStamped]) -> TransformStamped:
    """Source to fixed frame at one time, then fixed frame to target at another, as one."""
    back, there = answers
    return make_stamped(
        there.stamp_ns,
        there.frame_id,
        back.child_frame_id,
        (there.transform @ back.transform).as_pose(),
        max(back.extrapolated_ns, there.extrapolated_ns),
    )


def _columns(batch: TransformBatch | Iterable[TransformStamped]) -> Columns:
    if isinstance(batch, TransformBatch):
        return columns_of_batch(batch)
    if isinstance(batch, TransformStamped) or not isinstance(batch, Iterable):
        raise InvalidArgumentException(
            "batch: expected a tfbus.TransformBatch or several tfbus.TransformStamped, got a "
            f"{type(batch).__name__}"
        )
    return Columns.of_transforms(batch)


def _check_clock(clock: object) -> None:
    if not callable(clock):
        raise InvalidArgumentException(
            "clock must be callable and return nanoseconds since the Unix epoch, as node.clock; "
            f"got a {type(clock).__name__}"
        )
    if is_async(clock):
        raise TypeError("clock must be a plain function, not an async def")


if not cython.compiled:
    # Cython calls `__cinit__` of its own accord.
    def _new(cls: type[Buffer], *given: object, **named: object) -> Buffer:
        made = object.__new__(cls)
        made.__cinit__(*given, **named)
        return made

    setattr(Buffer, "__new__", _new)  # noqa: B010  # a constructor for mypy otherwise


def _freshness(max_age_s: float | None, living: bool) -> Freshness | None:
    return Freshness(max_age_s, living) if max_age_s is not None or living else None


def _stamp(stamp_ns: int | None) -> int | None:
    return None if stamp_ns is None else check_stamp(stamp_ns)


def _stamps(stamps_ns: ArrayLike) -> NDArray[np.int64]:
    stamps = np.asarray(stamps_ns)
    if stamps.ndim != 1 or (stamps.size and stamps.dtype.kind not in "iu"):
        hint = ""
        if stamps.ndim == 0:
            hint = "; for one stamp there is lookup_transform, or give a list of one"
        elif stamps.dtype.kind in "fMO":
            hint = "; tfbus.stamp_ns(...) converts seconds and datetimes"
        raise InvalidArgumentException(
            "stamps: expected integers of shape (N,), nanoseconds since the Unix epoch, got "
            f"{stamps.dtype} of {stamps.shape}{hint}"
        )
    if np.ma.is_masked(stamps_ns):
        raise InvalidArgumentException("stamps: some are masked; omit them (compressed())")
    if stamps.dtype.kind == "u" and stamps.size:
        check_stamp(stamps.max())
    return np.ascontiguousarray(stamps, dtype=np.int64)


def _too_few_for_twist(
    frame: str, reference_frame: str, stamp_ns: int, window_s: float
) -> TransformException:
    return ExtrapolationException(
        f"no velocity of {frame!r} relative to {reference_frame!r}: fewer than two samples within "
        f"{window_s:g} s",
        advice="widen window_s, or wait",
        requested_ns=stamp_ns,
    )
