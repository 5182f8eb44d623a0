"""Lookups: the answers now, or as soon as they come, or why there are none; and of many stamps,
along one path if it is the same for all of them.

Compiled if there is a C compiler (`lookup.pxd` has the C types).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

from tfbus.base import lazy_numpy as np
from tfbus.base.clock import Bell, Limit, LoopBell, limit_by
from tfbus.base.errors import (
    GapException,
    InvalidArgumentException,
    PastExtrapolationException,
    SingleSampleException,
    StaleException,
    TimeoutException,
    TransformException,
)
from tfbus.base.lazy_numpy import NDArray
from tfbus.buffer.explain import (
    Freshness,
    advice_after,
    check_seconds,
    may_come,
    why_not,
    without_waiting,
)
from tfbus.buffer.store import Store, Waiter
from tfbus.buffer.tree import Question
from tfbus.geometry.batch_lookup import by_time, fill
from tfbus.geometry.kernel import Path
from tfbus.geometry.sampling import Sampling
from tfbus.geometry.transform import TransformStamped, check_frame_id, check_stamp

try:
    import cython
except ImportError:
    from tfbus.base import cython_stub as cython

# Of many stamps, those for which the lock is held at a time: some microseconds.
_CHUNK = 256


class Lookup:
    """Questions to a store that are answered from one state of it, all or none.

    A lookup through a fixed frame asks two questions: first from the source to that frame, then
    from there to the target.
    """

    def __init__(
        self,
        store: Store,
        questions: tuple[Question, ...],
        sampling: Sampling | None = None,
        fresh: Freshness | None = None,
    ) -> None:
        self._store = store
        self._questions = questions
        self._sampling = store.sampling if sampling is None else check_sampling(sampling)
        self._fresh = fresh

    def answers(self) -> list[TransformStamped] | None:
        """The answers of this moment; None if one is missing or not fresh."""
        now_ns = self._now_ns()
        with self._store.lock:
            answers = self._ask(now_ns)
        if self._store.tree.unreported:
            self._store.report_questions()
        return answers if isinstance(answers, list) else None

    def wait(self, timeout_s: float) -> list[TransformStamped]:
        """The answers, as soon as there are some. Raises why there are none: at once if waiting
        does not help, and TimeoutException after `timeout_s`.
        """
        if timeout_s != 0.0:
            check_seconds(timeout_s, "timeout_s", least=-math.inf)
        answers = self._answers_or_error() if timeout_s <= 0.0 else self.answers()
        if isinstance(answers, list):
            return answers
        if answers is not None:
            raise answers
        if self._store.lock.is_mine():
            # A thread that holds the lock would wait for itself.
            raise self.error()
        changed = Bell()
        waiter = Waiter(changed.ring)
        self._store.waiters.add(waiter)
        try:
            with limit_by(self._store.clock, timeout_s, changed.ring) as limit:
                while True:
                    answers = self._answers_or_watch(waiter, limit, timeout_s)
                    if answers is not None:
                        return answers
                    changed.wait(limit.left_s)
        finally:
            self._store.waiters.discard(waiter)

    async def wait_async(self, timeout_s: float | None) -> list[TransformStamped]:
        """As `wait`, for asyncio; with None for ever."""
        if timeout_s is not None:
            check_seconds(timeout_s, "timeout_s", least=-math.inf)
        answers = self.answers()
        if answers is not None:
            return answers
        changed = LoopBell()
        waiter = Waiter(changed.ring)
        self._store.waiters.add(waiter)
        try:
            with limit_by(self._store.clock, timeout_s, changed.ring) as limit:
                while True:
                    answers = self._answers_or_watch(waiter, limit, timeout_s or 0.0)
                    if answers is not None:
                        return answers
                    await changed.wait(limit.left_s)
        finally:
            self._store.waiters.discard(waiter)

    def watch(self, waiter: Waiter) -> None:
        """Wake the waiter when the answers may have changed."""
        questions: Iterable[Question] = self._questions
        if self._fresh is not None:
            # Any sample of an edge may make it fresh, whatever stamp is asked for.
            questions = [(target, source, None) for target, source, _ in questions]
        with self._store.lock:
            self._store.waiters.watch(waiter, questions)

    def error(self) -> TransformException:
        """Why there are no answers, or no fresh ones: the error of the first question without."""
        self._check_arguments()
        now_ns = self._now_ns()
        with self._store.lock:
            failed = self._ask(now_ns)
            reason = self._why_not(self._questions[-1] if isinstance(failed, list) else failed)
        return self._store.explained(reason, self._questions)

    def _answers_or_error(self) -> list[TransformStamped] | TransformException:
        """The answers of this moment, or why there are none at the same moment."""
        self._check_arguments()
        now_ns = self._now_ns()
        with self._store.lock:
            answers = self._ask(now_ns)
            reason = None if isinstance(answers, list) else self._why_not(answers)
        if not isinstance(answers, list):
            assert reason is not None
            return self._store.explained(reason, self._questions)
        if self._store.tree.unreported:
            self._store.report_questions()
        return answers

    def _check_arguments(self) -> None:
        """Raise InvalidArgumentException for an invalid frame or stamp."""
        for what, frame in self._names():
            check_frame_id(frame, what)
        for _, _, stamp_ns in self._questions:
            if stamp_ns is not None:
                check_stamp(stamp_ns)

    def _now_ns(self) -> int:
        """The time that ages are from; not with the lock held, as the clock may be any function of
        the program.
        """
        return 0 if self._fresh is None else self._store.clock()

    # With the lock held

    def _ask(self, now_ns: int) -> list[TransformStamped] | Question | StaleException:
        """The answers; if there are none, the first question without, or why they are stale."""
        answers = []
        for question in self._questions:
            target_frame, source_frame, stamp_ns = question
            answer = self._store.tree.answer(target_frame, source_frame, stamp_ns, self._sampling)
            if answer is None:
                return question
            answers.append(answer)
        if self._fresh is not None:
            pairs = [question[:2] for question in self._questions]
            stale = self._fresh.why_stale(self._store.tree, pairs, now_ns)
            if stale is not None:
                return stale
        return answers

    def _why_not(self, failed: Question | StaleException) -> TransformException:
        """The error of a question without an answer."""
        if isinstance(failed, StaleException):
            error: TransformException = failed
        else:
            names = [frame for _, frame in self._names()]
            error = why_not(self._store.tree, names, failed, self._sampling)
        return without_waiting(error) if self._store.is_ended else error

    def _answers_or_watch(
        self, waiter: Waiter, limit: Limit, timeout_s: float
    ) -> list[TransformStamped] | None:
        """The answers; None if the waiter will be woken when it is worth asking again. Raises an
        error that waiting does not help, and TimeoutException when the time is up.
        """
        with self._store.lock:
            # A past that arrives from here on wakes the waiter once more.
            expected = frozenset(self._store.expected_pasts)
        if waiter.past_of in expected and not limit.passed:
            # It comes in parts: between the oldest and the newest there may still be a gap.
            return None
        self.watch(waiter)
        reason = self._answers_or_error()
        if isinstance(reason, list):
            return reason
        if not may_come(reason):
            waiter.past_of = _past_of(reason)
            if waiter.past_of not in expected:
                raise reason
        if limit.passed:
            ended = f"timed out after {timeout_s:g} s"
            if limit.cut_short:
                ended = "the node closes, which ends the lookup"
            raise TimeoutException(ended, reason=reason, advice=advice_after(reason)) from reason
        return None

    def _names(self) -> list[tuple[str, str]]:
        """The word for each frame in an error, and its name."""
        first, last = self._questions[0], self._questions[-1]
        names = [("target_frame", last[0]), ("source_frame", first[1])]
        return names if len(self._questions) == 1 else [*names, ("fixed_frame", first[0])]


def check_sampling(sampling: object) -> Sampling:
    """The sampling. Raises InvalidArgumentException for a value of another type."""
    if not isinstance(sampling, Sampling):
        raise InvalidArgumentException(
            f"sampling: expected a tfbus.Sampling, got a {type(sampling).__name__}"
        )
    return sampling


def _past_of(reason: TransformException) -> str | None:
    """The authority whose past may have samples for the time that was asked for."""
    if isinstance(reason, PastExtrapolationException | SingleSampleException | GapException):
        return reason.authority
    return None


# Many stamps


def lookup_many(
    store: Store,
    target_frame: str,
    source_frame: str,
    stamps: NDArray[np.int64],
    sampling: Sampling,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """The transforms at N stamps: `xyz` (N, 3) and `quat_xyzw` (N, 4); and which of them (N,) are
    known: the others are NaN.

    Raises LookupException or ConnectivityException if none of them can be known.
    """
    if store.path(target_frame, source_frame) is None:
        _check_connected(store, target_frame, source_frame, stamps)
    xyz, quat_xyzw = np.empty((len(stamps), 3)), np.empty((len(stamps), 4))
    known = np.empty(len(stamps), dtype=np.bool_)
    if len(stamps):
        _fill_chunks(
            store,
            target_frame,
            source_frame,
            stamps.data,
            by_time(stamps).data,
            xyz.reshape(-1).data,
            quat_xyzw.reshape(-1).data,
            known.view(np.uint8).data,
            sampling,
        )
    return xyz, quat_xyzw, known


def _fill_chunks(
    store: Store,
    target_frame: str,
    source_frame: str,
    stamps: Any,
    rows: Any,
    xyz: Any,
    quat: Any,
    known: Any,
    sampling: Sampling,
) -> None:
    count = len(stamps)
    strict = (
        sampling.interpolation != "nearest"
        and not sampling.extrapolation_s
        and sampling.max_gap_s is None
    )
    screw = sampling.interpolation == "screw"
    start = 0
    while start < count:
        path = store.path(target_frame, source_frame)
        before = start
        if strict and path is not None:
            # Python's other threads run meanwhile.
            with store.lock, cython.nogil:
                start = _fill_along(store, path, stamps, rows, start, xyz, quat, known, screw)
        if start == before:
            stop = min(start + _CHUNK, count)
            with store.lock:
                for j in range(start, stop):
                    i = rows[j] if len(rows) else j
                    answer = store.tree.answer(target_frame, source_frame, stamps[i], sampling)
                    _write_row(answer, i, xyz, quat, known)
            start = stop


def _fill_along(
    store: Store,
    path: Path,
    stamps: Any,
    rows: Any,
    start: int,
    xyz: Any,
    quat: Any,
    known: Any,
    screw: bool,
) -> int:
    """With the lock held: fill the rows from `start` on while the path is one for all times; the
    row it got to.
    """
    count = len(stamps)
    while start < count and path.topology == store.tree.topology and not path.is_mixed():
        stop = min(start + _CHUNK, count)
        fill(path, stamps, rows, start, stop, xyz, quat, known, screw)
        start = stop
        store.lock.let_others()
    return start


def _check_connected(
    store: Store, target_frame: str, source_frame: str, stamps: NDArray[np.int64]
) -> None:
    """Raise if no path joins the frames, neither now nor at one of the stamps."""
    with store.lock:
        are_known = target_frame in store.tree.frames and source_frame in store.tree.frames
    for stamp in stamps.tolist() if are_known else ():
        if Lookup(store, ((target_frame, source_frame, stamp),)).answers() is not None:
            return
    raise Lookup(store, ((target_frame, source_frame, None),)).error()


def _write_row(answer: TransformStamped | None, i: int, xyz: Any, quat: Any, known: Any) -> None:
    known[i] = answer is not None
    pose = (math.nan,) * 7 if answer is None else answer.transform.as_pose()
    for k in range(3):
        xyz[3 * i + k] = pose[k]
    for k in range(4):
        quat[4 * i + k] = pose[3 + k]
