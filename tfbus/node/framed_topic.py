"""Subscriptions whose messages come with the transform into a frame, when that is known."""

import inspect
import logging
import math
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields, is_dataclass
from typing import Any, NamedTuple, TypeVar

from tfbus.base import scheduler
from tfbus.base.arguments import is_async
from tfbus.base.clock import Timer
from tfbus.base.errors import (
    ConnectivityException,
    GapException,
    LookupException,
    TimeoutException,
    TransformException,
)
from tfbus.base.executor import Executor
from tfbus.base.signals import StopSignals
from tfbus.base.wording import counted, mistake_in
from tfbus.buffer.buffer import Buffer
from tfbus.buffer.messages import stamps_in
from tfbus.buffer.pending import PendingLookup
from tfbus.bus.session import Session
from tfbus.geometry.transform import check_frame_id
from tfbus.node.endpoint import Lane
from tfbus.node.surroundings import Describer
from tfbus.node.topic import Subscription

M = TypeVar("M")

# Reasons for which a message is dropped.
NO_FRAME = "no frame"
FRAME_UNKNOWN = "frame unknown"
TOO_OLD = "too old"
TIMED_OUT = "timed out"
IN_A_GAP = "in a gap"
QUEUE_FULL = "queue full"
REASONS = (QUEUE_FULL, FRAME_UNKNOWN, TOO_OLD, TIMED_OUT, IN_A_GAP, NO_FRAME)


@dataclass(frozen=True)
class InFrame:
    """Into which frame messages are to be transformed by a buffer: by the transform at their stamp,
    which is waited for until `tolerance_s` after it is known too, for at most `timeout_s`, by at
    most `queue` messages.
    """

    buffer: Buffer
    frame: str
    tolerance_s: float
    timeout_s: float
    queue: int


def into_frame(
    call: str,
    message_type: type,
    frame: str,
    buffer: Buffer | None,
    buffers: Sequence[Buffer],
    tolerance_s: float,
    timeout_s: float,
    queue: int,
) -> InFrame:
    """The frame that a subscription was made with. Raises TypeError and ValueError."""
    if is_dataclass(message_type):
        names = [each.name for each in fields(message_type)]
    else:  # a class of ROS
        names = list(getattr(message_type, "get_fields_and_field_types", dict)())
    if not {"stamp_ns", "frame_id"} <= {*names}:
        raise TypeError(
            f"{call} with in_frame: messages must have stamp_ns and frame_id, as "
            f"tfbus.messages.PoseStamped has, and those of {message_type.__name__} have "
            f"{', '.join(names) or 'no fields'}"
        )
    if buffer is None and not buffers:
        raise ValueError(
            f"{call} with in_frame needs transforms: make a TransformListener(buffer, node) "
            "before, or give buffer="
        )
    for name, value in (("tolerance_s", tolerance_s), ("timeout_s", timeout_s)):
        if not 0.0 <= value < math.inf:
            raise ValueError(f"{name} must be a number of seconds, 0 or more, not {value!r}")
    if type(queue) is not int or not 1 <= queue <= _LONGEST_QUEUE:
        raise ValueError(f"queue must be an int from 1 to {_LONGEST_QUEUE}, not {queue!r}")
    into = buffers[0] if buffer is None else buffer
    return InFrame(into, check_frame_id(frame, "in_frame"), tolerance_s, timeout_s, queue)


# The first messages of a subscription may be older than all transforms that its listener heard.
_JUST_BEFORE_NS = 2_000_000_000

# The description names no more frames.
_MOST_SOURCES = 10

# Large messages wait in it.
_LONGEST_QUEUE = 10_000


class _Waiting(NamedTuple):
    number: int
    message: Any
    lookup: PendingLookup


class FramedSubscription(Subscription[M]):
    """Calls `callback(message, transform)` when the transform of a message is known.

    The messages of one frame come in their order; a message of an unknown frame holds up no others.
    Each that is not passed on is counted in `drops` by its reason: "queue full", "frame unknown",
    "too old", "timed out", "in a gap" or "no frame"; the first of each is logged. `waiting`
    messages may get their transform yet. It has the counts of a Subscription as well.
    """

    def __init__(
        self,
        session: Session,
        lane: Lane,
        executor: Executor,
        log: logging.Logger,
        message_type: type[M],
        topic: str,
        callback: Callable[[M, Any], Any] | None,
        into: InFrame,
        signals: StopSignals,
        describers: list[Describer],
        *,
        retained: bool = False,
    ) -> None:
        self.into = into
        self.drops: Counter[str] = Counter()
        self.passed = 0
        self.last_drop, self._last_drop_ns = "", 0
        self._dropped_of: tuple[str, ...] = ()
        self._executor = executor
        self._began_ns = into.buffer.clock()
        # Guards all below; a poll of a lookup may call any program's clock.
        self._order = scheduler.RLock()
        self._queues: dict[str, deque[_Waiting]] = {}
        self._numbers = 0
        # For the first message that waits too long.
        self._timer: Timer | None = None
        self._due_s = math.inf
        super().__init__(
            session,
            lane,
            log,
            message_type,
            topic,
            None if callback is None else self._with_transform(callback),
            signals=signals,
            retained=retained,
        )
        self._describers = describers
        describers.append(self.describe)

    @property
    def waiting(self) -> int:
        """How many messages wait for their transform."""
        with self._order:
            return sum(map(len, self._queues.values()))

    def close(self) -> None:
        """End it, also for messages that wait. Twice is fine."""
        super().close()
        with suppress(ValueError):
            self._describers.remove(self.describe)
        with self._order:
            for queue in self._queues.values():
                for each in queue:
                    each.lookup.close()
            self._queues.clear()
            if self._timer is not None:
                self._timer.cancel()

    def describe(self) -> dict[str, list[Any]]:
        """The entry of the node's description."""
        described = {
            "topic": self.name,
            "frame": self.into.frame,
            "waiting": self.waiting,
            "passed": self.passed,
            "drops": {reason: self.drops[reason] for reason in REASONS if self.drops[reason]},
            "last": self.last_drop,
            "last_ns": self._last_drop_ns,
            "sources": self._sources(),
        }
        return {"filters": [described]}

    def _sources(self) -> list[str]:
        """The frames of messages that wait, and of the last that was dropped; the first few."""
        with self._order:
            return sorted({*self._queues, *self._dropped_of})[:_MOST_SOURCES]

    def _receive(self, message: Any) -> None:
        frame = message.frame_id
        if mistake := mistake_in(frame):
            self._drop(message, NO_FRAME, f"its frame_id {mistake}")
            return
        with self._order:
            if self.closed:
                return
            if self.waiting >= self.into.queue:
                self._drop_oldest()
            lookup = PendingLookup(
                self.into.buffer,
                self.into.frame,
                frame,
                self._until_ns(message),
                self.into.timeout_s,
                self._poll_soon,
            )
            self._numbers += 1
            self._queues.setdefault(frame, deque()).append(_Waiting(self._numbers, message, lookup))
            self._poll(frame)

    def _until_ns(self, message: Any) -> int | None:
        """The latest time at which its transform is needed; None for a stamp of 0: any."""
        stamps = stamps_in(message)
        last_ns = message.stamp_ns if stamps is None or not len(stamps) else int(stamps.max())
        return last_ns + round(self.into.tolerance_s * 1e9) if message.stamp_ns else None

    def _poll_soon(self) -> None:
        self._executor.submit(f"transforms of {self._what}", self._poll_all, limit=1)

    def _poll_all(self) -> None:
        with self._order:
            self._poll(*self._queues)

    def _poll(self, *frames: str) -> None:
        """Pass on the messages of these frames whose transform is known by now."""
        known = [message for frame in frames for message in self._take_known(frame)]
        self._hand_over(*known, most_beside=self.into.queue)
        self._set_timer()

    def _set_timer(self) -> None:
        """Have one timer, for the message whose wait ends first: the first of its frame."""
        left_s = [
            queue[0].lookup.left_s
            for queue in self._queues.values()
            if queue[0].lookup.left_s is not None
        ]
        now_s = scheduler.monotonic()
        due_s = now_s + max(min(left_s), 1e-3) if left_s else math.inf
        if self._due_s <= now_s or due_s < self._due_s:
            if self._timer is not None:
                self._timer.cancel()
            self._due_s, self._timer = due_s, None
            if left_s and not self.closed:
                self._timer = self._executor.after(due_s - now_s, self._poll_all)

    def _take_known(self, frame: str) -> Iterator[Any]:
        """Take the messages of a frame whose transform is known by now, in their order."""
        queue = self._queues[frame]
        while queue:
            try:
                if not queue[0].lookup.poll():
                    return
            except TransformException as error:
                self._drop(queue[0].message, _reason(error), str(error))
            else:
                yield queue[0].message
            queue.popleft().lookup.close()
        del self._queues[frame]

    def _drop_oldest(self) -> None:
        frame = min(self._queues, key=lambda each: self._queues[each][0].number)
        oldest = self._queues[frame].popleft()
        if not self._queues[frame]:
            del self._queues[frame]
        oldest.lookup.close()
        self._drop(oldest.message, QUEUE_FULL, f"{counted(self.into.queue, 'message')} may wait")

    def _drop(self, message: Any, reason: str, why: str) -> None:
        with self._lock:
            self.drops[reason] += 1
            self._dropped_of = (message.frame_id,)
            self.last_drop = f"frame {message.frame_id!r}, {reason}: {why}"[:500]
            self._last_drop_ns = scheduler.time_ns()
        text = "Dropped a message on topic %r of frame %r, for its transform into %r (%s): %s"
        values = (self.name, message.frame_id, self.into.frame, reason, why)
        if reason == TOO_OLD and 0 <= self._began_ns - message.stamp_ns < _JUST_BEFORE_NS:
            text += ". It is from before this subscription"
            self._log_once.info((reason, "before"), text, *values)
        else:
            self._log_once.warning(reason, text, *values)

    # In the callback's thread

    def _with_transform(self, callback: Callable[[M, Any], Any]) -> Callable[[M], Any]:
        with suppress(ValueError):  # some of C say nothing of their arguments
            try:
                inspect.signature(callback).bind(None, None)
            except TypeError as error:
                name = getattr(callback, "__name__", "callback")
                raise TypeError(
                    f"{name}: with in_frame a callback gets two arguments, the message and its "
                    f"transform ({error})"
                ) from error

        def call(message: M) -> Any:
            pair = self._item(message)
            return None if pair is None else callback(*pair)

        async def call_async(message: M) -> None:
            pair = self._item(message)
            if pair is not None:
                await callback(*pair)

        return call_async if is_async(callback) else call

    def _item(self, message: Any) -> Any:
        """The message and its transform; None if that is not known any longer."""
        buffer, target = self.into.buffer, self.into.frame
        stamps = stamps_in(message)
        try:
            if stamps is None or not len(stamps):
                stamp_ns = message.stamp_ns or None
                transform: Any = buffer.lookup_transform(target, message.frame_id, stamp_ns)
            else:
                transform = buffer.lookup_transforms(target, message.frame_id, stamps)
        except TransformException as error:
            self._drop(message, _reason(error), str(error))
            return None
        with self._lock:
            self.passed += 1
        return message, transform


def _reason(error: TransformException) -> str:
    if isinstance(error, TimeoutException) and isinstance(error.reason, TransformException):
        is_unknown = isinstance(error.reason, LookupException | ConnectivityException)
        return FRAME_UNKNOWN if is_unknown else TIMED_OUT
    if isinstance(error, LookupException | ConnectivityException):
        return FRAME_UNKNOWN
    return IN_A_GAP if isinstance(error, GapException) else TOO_OLD
