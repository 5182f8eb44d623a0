"""The log of all that sessions send in a simulated network, to compare two runs of a seed."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, TextIO

from tfbus.testing.declarations import Declarations
from tfbus.testing.zenoh_session import ZenohSession


@contextmanager
def logged(into: TextIO) -> Iterator[None]:
    """Until the end of the `with`, write a line for each message, query and declaration: the time
    in nanoseconds, how many turns tasks had before, the process, its thread, and what it sends.
    """
    put, get, change = ZenohSession.put, ZenohSession.get, Declarations.change

    def note(session: ZenohSession, *words: object) -> None:
        tasks, process = session.tasks, session.process.name
        text = " ".join(map(str, words))
        into.write(f"{tasks.now_ns} {tasks.turns} {process} {tasks.current.name} {text}\n")

    def logged_put(session: ZenohSession, key: str, payload: bytes, **options: Any) -> None:
        note(session, "put", key, bytes(payload).hex())
        put(session, key, payload, **options)

    def logged_get(session: ZenohSession, selector: str, *args: Any, **options: Any) -> None:
        note(session, "get", selector, bytes(options.get("payload") or b"").hex())
        get(session, selector, *args, **options)

    def logged_change(declarations: Declarations, kind: str, full: str, by: int) -> None:
        note(declarations._session, "declare" if by > 0 else "undeclare", kind, full)
        change(declarations, kind, full, by)

    patches = (
        (ZenohSession, "put", logged_put, put),
        (ZenohSession, "get", logged_get, get),
        (Declarations, "change", logged_change, change),
    )
    for owner, name, ours, _ in patches:
        setattr(owner, name, ours)
    try:
        yield
    finally:
        for owner, name, _, own in patches:
            setattr(owner, name, own)
