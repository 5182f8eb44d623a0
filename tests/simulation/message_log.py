"""The log of all that sessions send in a simulated network, to compare two runs of a seed."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, TextIO

from tfbus.testing.declarations import Declarations
from tfbus.testing.network import Network
from tfbus.testing.processes import Host, Process, ProcessTable
from tfbus.testing.zenoh_session import ZenohSession


@contextmanager
def logged(into: TextIO) -> Iterator[None]:
    """Until the end of the `with`, write a line for each message, query and declaration: the time
    in nanoseconds, how many turns tasks had before, the process, its thread, and what it sends.
    Begins and ends of processes have lines, and the end of each network, with its error.
    """
    put, get, change = ZenohSession.put, ZenohSession.get, Declarations.change
    leave, add, end = Network.__exit__, ProcessTable.add, ProcessTable.end

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
        note(declarations.session, "declare" if by > 0 else "undeclare", kind, full)
        change(declarations, kind, full, by)

    def logged_add(table: ProcessTable, host: Host, name: str) -> Process:
        process = add(table, host, name)
        note_process(table, "begin", process)
        return process

    def logged_end(table: ProcessTable, process: Process) -> None:
        note_process(table, "end", process)
        end(table, process)

    def note_process(table: ProcessTable, what: str, process: Process) -> None:
        tasks = table.tasks
        into.write(f"{tasks.now_ns} {tasks.turns} {process.name} {tasks.current.name} {what}\n")

    def logged_leave(network: Network, kind: Any, error: Any, trace: Any) -> None:
        tasks, why = network.tasks, "" if kind is None else f": {kind.__name__}: {error}"
        said = " ".join(f"end of seed {network.seed}{why}".splitlines())
        into.write(f"{tasks.now_ns} {tasks.turns} {said}\n")
        leave(network, kind, error, trace)

    patches = (
        (Network, "__exit__", logged_leave, leave),
        (ProcessTable, "add", logged_add, add),
        (ProcessTable, "end", logged_end, end),
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
