"""Asking a buffer, waiting for what is not there yet, and saying why there is no answer.

One of the modules that are compiled where there is a C compiler (`answering.pxd` says the C types).
"""

import threading
from collections.abc import Iterable, Sequence
from contextlib import suppress

from tfbus.buffer.explain import may_come, unknown_frame, why_not
from tfbus.buffer.freshness import Freshness
from tfbus.buffer.store import Store
from tfbus.buffer.waiting import Question, Waiter
from tfbus.core.sampling import Sampling
from tfbus.errors import (
    ConnectivityException,
    ExtrapolationException,
    LookupException,
    PastExtrapolationException,
    SingleSampleException,
    StaleException,
    TimeoutException,
    TransformException,
)
from tfbus.geometry.transform import TransformStamped, check_frame_id, check_stamp
from tfbus.runtime.clock import Limit, limit_by


class Answering(Store):
    """A store that is asked questions, at once or with patience."""

    # At once

    def _ask(
        self,
        questions: Sequence[Question],
        sampling: Sampling | None,
        fresh: Freshness | None = None,
    ) -> list[TransformStamped] | None:
        """The answers, of one state of the buffer; None where one is missing or not fresh."""
        answers = self._answers(questions, sampling, fresh)
        if self._tree.untold:
            self._tell_questions()
        return answers

    def _answers(
        self,
        questions: Sequence[Question],
        sampling: Sampling | None,
        fresh: Freshness | None,
    ) -> list[TransformStamped] | None:
        answers = []
        with self._lock:
            for target_frame, source_frame, stamp_ns in questions:
                answer = self._tree.answer(
                    target_frame,
                    source_frame,
                    stamp_ns,
                    self.sampling if sampling is None else sampling,
                )
                if answer is None:
                    return None
                answers.append(answer)
            if fresh is not None and self._why_stale(questions, fresh) is not None:
                return None
        return answers

    def _why_stale(self, questions: Sequence[Question], fresh: Freshness) -> StaleException | None:
        """With the lock held: why the answers to the questions are not fresh enough."""
        pairs = [question[:2] for question in questions]
        return fresh.why_stale(self._tree, pairs, self.clock())

    # With patience

    def _wait(
        self,
        questions: Sequence[Question],
        timeout_s: float,
        sampling: Sampling | None,
        fresh: Freshness | None = None,
    ) -> list[TransformStamped]:
        answers = self._ask(questions, sampling, fresh)
        if answers is not None:
            return answers
        if timeout_s <= 0.0:
            raise self._why_none(questions, sampling, fresh)
        changed = threading.Event()
        waiter = Waiter(changed.set)
        self._waiters.add(waiter)
        try:
            with limit_by(self.clock, timeout_s, changed.set) as limit:
                while True:
                    changed.clear()
                    answers = self._ask_once(waiter, limit, timeout_s, questions, sampling, fresh)
                    if answers is not None:
                        return answers
                    changed.wait(limit.left_s)
        finally:
            self._waiters.discard(waiter)

    async def _wait_async(
        self,
        questions: Sequence[Question],
        timeout_s: float | None,
        sampling: Sampling | None,
        fresh: Freshness | None = None,
    ) -> list[TransformStamped]:
        answers = self._ask(questions, sampling, fresh)
        if answers is not None:
            return answers
        import asyncio  # which takes long, and most processes have no use for

        loop = asyncio.get_running_loop()
        changed = asyncio.Event()

        def wake() -> None:
            # The loop may be closed already, and nobody there to be woken.
            with suppress(RuntimeError):
                loop.call_soon_threadsafe(changed.set)

        waiter = Waiter(wake)
        self._waiters.add(waiter)
        try:
            with limit_by(self.clock, timeout_s, wake) as limit:
                while True:
                    changed.clear()
                    answers = self._ask_once(
                        waiter, limit, timeout_s or 0.0, questions, sampling, fresh
                    )
                    if answers is not None:
                        return answers
                    with suppress(TimeoutError):
                        async with asyncio.timeout(limit.left_s):
                            await changed.wait()
        finally:
            self._waiters.discard(waiter)

    def _ask_once(
        self,
        waiter: Waiter,
        limit: Limit,
        timeout_s: float,
        questions: Sequence[Question],
        sampling: Sampling | None,
        fresh: Freshness | None,
    ) -> list[TransformStamped] | None:
        """The answers; None where it is worth waiting until the waiter is woken, which it will be
        from now on. Raises what waiting cannot mend, and when the time is up.
        """
        with self._lock:
            # Those that end from here on wake the waiter once more.
            expected = frozenset(self._expected_pasts)
        if waiter.past_of in expected and not limit.passed:
            # It comes in parts: between the oldest and the newest there may still be a gap.
            return None
        self._watch(waiter, questions, fresh)
        answers = self._ask(questions, sampling, fresh)
        if answers is not None:
            return answers
        reason = self._why_none(questions, sampling, fresh)
        if not may_come(reason):
            waiter.past_of = _past_of(reason)
            if waiter.past_of not in expected:
                raise reason
        if limit.passed:
            raise TimeoutException(
                f"waited {timeout_s:g} s in vain: {reason}", reason=reason
            ) from reason
        return None

    def _watch(
        self, waiter: Waiter, questions: Sequence[Question], fresh: Freshness | None = None
    ) -> None:
        if fresh is not None:
            # Any sample of an edge may make it fresh, whatever stamp is asked for.
            questions = [(target, source, None) for target, source, _ in questions]
        with self._lock:
            self._waiters.watch(waiter, questions)

    # Why there is none

    def _why_none(
        self,
        questions: Sequence[Question],
        sampling: Sampling | None,
        fresh: Freshness | None = None,
    ) -> TransformException:
        """The error for the first of the questions that has no answer, or no fresh one."""
        # All names first, as tf2 does: a time is of no use to a frame that is not known.
        names = {"target_frame": questions[-1][0], "source_frame": questions[0][1]}
        if len(questions) > 1:
            names["fixed_frame"] = questions[0][0]
        error = self._misnamed(names)
        if error is not None:
            return self._explained(error, questions)
        for question in questions[:-1]:
            if self._ask((question,), sampling) is None:
                return self._why_not(question, sampling)
        if fresh is not None and self._ask(questions, sampling) is not None:
            with self._lock:
                stale = self._why_stale(questions, fresh)
            if stale is not None:
                return stale
        return self._why_not(questions[-1], sampling)

    def _why_not(self, question: Question, sampling: Sampling | None) -> TransformException:
        target_frame, source_frame, stamp_ns = question
        if self._tree.untold:
            self._tell_questions()
        misnamed = self._misnamed({"target_frame": target_frame, "source_frame": source_frame})
        if misnamed is not None:
            return self._explained(misnamed, (question,))
        if stamp_ns is not None:
            check_stamp(stamp_ns)
        with self._lock:
            error = why_not(
                self._tree,
                target_frame,
                source_frame,
                stamp_ns,
                self.sampling if sampling is None else sampling,
            )
        self.shortfall.note(error, self.cache_time_s)
        if isinstance(error, ConnectivityException):
            error = self._explained(error, (question,))
        return error or ExtrapolationException(
            f"{source_frame!r} could not be seen from {target_frame!r} a moment ago, and can be "
            "now: ask again",
            requested_ns=stamp_ns,
        )

    def _explained(
        self, error: TransformException, questions: Iterable[Question]
    ) -> TransformException:
        """The error, or the one that a reader of what is asked for has in its place."""
        if self._readers and isinstance(error, LookupException | ConnectivityException):
            for target_frame, source_frame, _ in questions:
                if self._ask_path(target_frame, source_frame) is None:
                    for _, explain in self._readers:
                        better = explain(target_frame, source_frame)
                        if better is not None:
                            return better
        return error

    def _misnamed(self, names: dict[str, str]) -> TransformException | None:
        for what, frame in names.items():
            check_frame_id(frame, what)
            if frame not in self._tree.frames:
                return self._unknown(frame)
        return None

    def _unknown(self, frame: str) -> TransformException:
        with self._lock:
            names = list(self._tree.frames)
        return unknown_frame(frame, names)


def _past_of(reason: TransformException) -> str | None:
    """The authority whose samples begin after the time that was asked for."""
    if isinstance(reason, PastExtrapolationException | SingleSampleException):
        return reason.authority
    return None
