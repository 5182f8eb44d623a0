"""Carries keys and bytes between the bus and a program that has no Zenoh of its own.

    cc -std=c99 -O2 -o tfbus_wire examples/wire/tfbus_wire.c -lm
    python examples/wire/shuttle.py ./tfbus_wire listen
    python examples/wire/shuttle.py ./tfbus_wire talk NAME

The program reads lines from its standard input and writes lines to its standard output, as
tfbus_wire.c says; other lines that it writes are printed. Ctrl-C ends both.
"""

import os
import socket
import subprocess
import sys
import threading
import time
from contextlib import suppress
from functools import partial
from typing import Any

from talk import answer, retained
from tfbus_wire import open_session
from zenoh import (
    CongestionControl,
    Priority,
    Reply,
    ReplyKeyExpr,
    Sample,
    SampleKind,
    Session,
    Timestamp,
    ext,
)


def main() -> None:
    with open_session() as session:
        program = subprocess.Popen(
            sys.argv[1:], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        reader = threading.Thread(target=to_bus, args=(session, program))
        reader.start()
        with suppress(KeyboardInterrupt):
            from_bus(session, program)
        code = program.poll() or 0
        program.terminate()
        reader.join()
    sys.exit(code)


def from_bus(session: Session, program: subprocess.Popen[str]) -> None:
    """Write to the program what comes, and ten times a second the time."""
    lock, given = threading.RLock(), program.stdin
    assert given

    def write(line: str) -> None:
        if line.isprintable():  # as every key of tfbus is
            with lock, suppress(BrokenPipeError, ValueError):
                given.write(line + "\n")
                given.flush()

    newest: dict[str, Timestamp] = {}

    def on_sample(sample: Sample) -> None:
        key, stamp = str(sample.key_expr), sample.timestamp
        with lock:
            # What is retained comes by queries too, and the answer may be the older one.
            if stamp is not None and key in newest and stamp < newest[key]:
                return
            if stamp is not None:
                newest[key] = stamp
            write(f"message {sample.payload.to_bytes().hex()} {key}")

    def on_reply(reply: Reply) -> None:
        if reply.ok:
            on_sample(reply.ok)

    def on_token(token: Sample) -> None:
        key = token.key_expr
        write(f"lost {key}" if token.kind == SampleKind.DELETE else f"alive {key}")
        if token.kind == SampleKind.PUT:
            session.get(f"{key}/@adv/pub/**", on_reply, accept_replies=ReplyKeyExpr.ANY)

    write(f"session {session.info.zid()} {socket.gethostname()} {os.getpid()}")
    history = ext.HistoryConfig(max_samples=1, detect_late_publishers=True)
    recovery = ext.RecoveryConfig(periodic_queries=None, heartbeat=True)
    tokens, streams = session.liveliness(), "@tfbus/stream/*"
    declared = [
        ext.declare_advanced_subscriber(
            session, "tf_static/*", on_sample, history=history, recovery=recovery
        ),
        session.declare_subscriber("tf/**", on_sample),
        session.declare_subscriber(streams, on_sample),
        tokens.declare_subscriber(streams, on_token, history=True),
    ]
    while declared and program.poll() is None:
        write(f"now {time.time_ns()}")
        time.sleep(0.1)


def to_bus(session: Session, program: subprocess.Popen[str]) -> None:
    """Send what the program writes."""
    declared: dict[str, Any] = {}
    assert program.stdout
    for line in program.stdout:
        verb, _, rest = line.rstrip("\n").partition(" ")
        data, _, key = rest.partition(" ")
        if verb == "token":
            declared[line] = session.liveliness().declare_token(rest)
        elif verb == "put":
            congestion, priority = CongestionControl.DROP, Priority.INTERACTIVE_HIGH
            session.put(key, bytes.fromhex(data), congestion_control=congestion, priority=priority)
        elif verb == "retain":
            declared.setdefault(key, retained(session, key)).put(bytes.fromhex(data))
        elif verb == "answer":
            declared[key] = answer(session, key, partial(bytes.fromhex, data))
        else:
            print(line, end="", flush=True)


if __name__ == "__main__":
    main()
