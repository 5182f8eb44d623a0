"""Budgets of a listener: its tables, queues and waits stay within their bounds."""

from collections.abc import Iterator
from typing import TYPE_CHECKING

from tests.builders import store_of
from tests.streams.received import registry_of, watch_of
from tfbus.base.executor import Executor
from tfbus.streams.listener import TransformListener
from tfbus.testing.zenoh_session import ZenohSession

if TYPE_CHECKING:
    from tests.simulation.histories import Part

# Nothing is asked of a stream that is gone, and nothing of it measured, after this time: the
# longest pause between two questions, and the longest wait for an answer.
FORGOTTEN_WITHIN_S = 20.0
# So many callbacks may wait for a thread, and so many timers for their time; more with streams.
MOST_READY, MOST_DUE, MORE_A_STREAM = 50, 50, 3
# A session declares so much, and waits for the ends of so many queries; more with streams.
MOST_DECLARED, MOST_ASKED, MORE_ASKED_A_STREAM = 60, 120, 10
# The streams of a history, with five frames each, take so much in its listener's estimate.
MOST_BYTES_A_STREAM = 30_000
# A node of a history has no more questions under way at once, each of which may wait for a frame.
MOST_WAITERS = 20


def beyond(part: "Part", gone_for_s: dict[str, float]) -> Iterator[str]:
    """Each bound that a listener exceeds, as a sentence; `gone_for_s` is for how long it has taken
    each stream for gone.
    """
    listener = part.listener
    for stream, seconds in gone_for_s.items():
        if seconds > FORGOTTEN_WITHIN_S:
            for what in _kept_of(listener, stream):
                yield f"stream {stream} is gone for {FORGOTTEN_WITHIN_S:g} s, and {what}"
    for executor in (part.node.executor, watch_of(listener)._executor):
        yield from _full(executor, MORE_A_STREAM * len(gone_for_s))
    for session in part.process.sessions:
        yield from _full_tables(session, len(gone_for_s))
    taken = listener._budget.bytes
    if taken > MOST_BYTES_A_STREAM * len(registry_of(listener).streams()):
        yield f"its streams take {taken} bytes"
    waiters = part.buffer.waiting
    if waiters > MOST_WAITERS:
        yield f"{waiters} lookups wait in a buffer"


def _kept_of(listener: TransformListener, stream: str) -> Iterator[str]:
    watch = watch_of(listener)
    if watch.is_asking(watch.streams()[stream].key):
        yield "its description is asked for"
    if listener._recovery.is_asking(stream):
        yield "its static transforms are asked for"
    if listener._offsets.is_watching(stream):
        yield "its clock is measured"
    if stream in store_of(listener.buffer).expected_pasts:
        yield "its history is expected"


def _full(executor: Executor, more: int) -> Iterator[str]:
    ready, due = executor.waiting()
    if ready > MOST_READY + more:
        yield f"{ready} callbacks wait for a thread"
    if due > MOST_DUE + more:
        yield f"{due} timers wait"


def _full_tables(session: ZenohSession, streams: int) -> Iterator[str]:
    """The tables of a session that its program lets grow."""
    declared = sum(map(len, session.declarations.own.values()))
    if declared > MOST_DECLARED + MORE_A_STREAM * streams:
        yield f"its session has {declared} declarations"
    asked = len(session.queries.asked)
    if asked > MOST_ASKED + MORE_ASKED_A_STREAM * streams:
        yield f"its session waits for {asked} queries"
