"""`tfbus bag record`: everything on the bus, or a part of it, into a file."""

import os
import re
import shlex
import signal
import socket
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from tfbus.bag.capture import Capture
from tfbus.bag.keeping import Splits
from tfbus.bag.parts_written import PartsWritten, existing_parts, path_of_recording
from tfbus.bag.past import Past
from tfbus.bag.raw_queue import RawQueue
from tfbus.bag.recorder import Recorder, Snapshots
from tfbus.bag.trigger import Condition, Triggers
from tfbus.bus.settings import NodeSettings
from tfbus.cli.bag.record_status import (
    Look,
    Rating,
    StatusLine,
    log_text,
    status_parts,
    summary,
)
from tfbus.cli.output import is_terminal, print_lines, warn
from tfbus.command.extras import install_command
from tfbus.command.keyboard import KeyReader
from tfbus.command.options import bus_options
from tfbus.command.several import Several
from tfbus.command.terminal import NoTerminalError, RawTerminal
from tfbus.command.types import POSITIVE, FrameName, Size, TopicName
from tfbus.discover.other_namespaces import frames_in_other_namespaces, where_to_look
from tfbus.errors import InvalidArgumentException, ServiceError, TfbusError
from tfbus.messages import Empty
from tfbus.node.node import Node
from tfbus.recording.selection import Selection, is_of_transforms
from tfbus.recording.writer import RecordingWriter
from tfbus.runtime.clock import SYSTEM_CLOCK
from tfbus.runtime.executor import Executor
from tfbus.wire.keys import check_no_transforms
from tfbus.wording import listed, printable

# What may wait to be written, and what is held for a snapshot.
_CACHE_BYTES = 100_000_000
_SNAPSHOT_CACHE_BYTES = 500_000_000

_LOOK_EVERY_S = 0.25
_LOG_EVERY_S = 10.0

# Where nothing has come after this time, it says what it waits for.
_SILENT_S = 3.0

_STANDARD_INPUT = 0

_KEYS = {False: "space pauses, s begins a new file, q ends", True: "s writes a snapshot, q ends"}


@dataclass(frozen=True)
class _Plan:
    """What is asked for on the command line."""

    path: Path
    selection: Selection
    everywhere: bool
    splits: Splits
    compression: Any
    cache_bytes: int
    snapshot_s: float | None
    conditions: tuple[Condition, ...]
    with_history: bool
    starts_paused: bool
    has_keys: bool


@click.command(
    "record",
    epilog="Examples: tfbus bag record; tfbus bag record -o run --max-size 500MB; tfbus bag record "
    "--topics turtle1/pose tf; tfbus bag record --snapshot 30 --on 'gone base_link'",
)
@click.argument("more_topics", metavar="[TOPIC]...", type=TopicName(), nargs=-1)
@click.option(
    "--topics",
    cls=Several,
    multiple=True,
    type=TopicName(),
    metavar="NAME...",
    help="Record these topics only; tf stands for all transforms.",
)
@click.option(
    "--streams",
    cls=Several,
    multiple=True,
    metavar="NAME...",
    help="Record transforms of these streams only.",
)
@click.option(
    "--frames",
    cls=Several,
    multiple=True,
    type=FrameName(),
    metavar="NAME...",
    help="Record transforms of these child frames only.",
)
@click.option(
    "-e",
    "--regex",
    default="",
    metavar="REGEX",
    help="Record topics and streams in whose names this is found.",
)
@click.option(
    "-x",
    "--exclude",
    "--exclude-regex",
    default="",
    metavar="REGEX",
    help="Omit topics and streams in whose names this is found.",
)
@click.option(
    "--exclude-topics", cls=Several, multiple=True, metavar="NAME...", help="Omit these topics."
)
@click.option("-a", "--all", is_flag=True, hidden=True, help="Record everything, the default.")
@click.option(
    "--fleet", is_flag=True, help="Record the namespaces below too: all robots of a fleet."
)
@click.option(
    "-o",
    "--output",
    metavar="FILE",
    help="The file to write, or a folder for it (default tfbus_<date>-<time>.mcap).",
)
@click.option(
    "-b",
    "--max-size",
    "--max-bag-size",
    "max_bytes",
    type=Size(),
    metavar="SIZE",
    help="Go on in a new file after this size, such as 500MB.",
)
@click.option(
    "-d",
    "--max-duration",
    "--max-bag-duration",
    "max_s",
    type=POSITIVE,
    metavar="S",
    help="Go on in a new file after this many seconds.",
)
@click.option(
    "--compression",
    "--compression-format",
    type=click.Choice(("zstd", "lz4", "none")),
    default="zstd",
    show_default=True,
    help="How to compress; lz4 takes half the time.",
)
@click.option(
    "--snapshot",
    "snapshot_s",
    type=POSITIVE,
    metavar="S",
    help="Hold the last S seconds in memory, and write them when asked.",
)
@click.option(
    "--on",
    "conditions",
    multiple=True,
    metavar="EVENT",
    help="With --snapshot, also write when this happens: 'gone FRAME' or 'conflict FRAME'; "
    "without FRAME any. Repeatable.",
)
@click.option(
    "--max-cache-size",
    "cache_bytes",
    type=Size(),
    metavar="SIZE",
    help="Memory for messages that wait to be written (default 100MB), or for the snapshot "
    "(default 500MB).",
)
@click.option(
    "--history",
    "with_history",
    is_flag=True,
    help="Begin with what publishers still hold of the last seconds.",
)
@click.option(
    "--start-paused", "starts_paused", is_flag=True, help="Record nothing until it is resumed."
)
@click.option(
    "--disable-keyboard-controls", "no_keys", is_flag=True, help="Take no keys in a terminal."
)
@click.option("-s", "--storage", type=click.Choice(("mcap",)), hidden=True)
@click.option(
    "--node-name",
    "--name",
    default="recorder",
    metavar="NAME",
    show_default=True,
    help="The name of its node, and so of its services.",
)
@bus_options("recorder")
def command(
    settings: NodeSettings,
    more_topics: tuple[str, ...],
    topics: tuple[str, ...],
    streams: tuple[str, ...],
    frames: tuple[str, ...],
    regex: str,
    exclude: str,
    exclude_topics: tuple[str, ...],
    all: bool,
    fleet: bool,
    output: str | None,
    max_bytes: int | None,
    max_s: float | None,
    compression: str,
    snapshot_s: float | None,
    conditions: tuple[str, ...],
    cache_bytes: int | None,
    with_history: bool,
    starts_paused: bool,
    no_keys: bool,
    storage: str | None,
    node_name: str,
) -> None:
    """Record the bus into an MCAP file: transforms, topics, and who was there.

    Everything is recorded, unless topics, streams, frames or a regular expression say what. Names
    are relative to the namespace. The file is never one that exists. What has come is on the disk
    within a second, so a crash loses no more. Ctrl-C ends the recording.

    In a terminal the space key pauses, s begins a new file (or writes the snapshot), q ends. The
    services recorder/pause, resume, split, snapshot and stop do the same.
    """
    if snapshot_s is None and conditions:
        raise click.UsageError("--on writes a snapshot: give --snapshot SECONDS too")
    if snapshot_s is not None and (max_bytes or max_s):
        raise click.UsageError(
            "each snapshot is a file of its own: --max-size and --max-duration are for recordings "
            "without --snapshot"
        )
    try:
        settings = settings.renamed(node_name)
        plan = _Plan(
            path=_free_path(output),
            selection=_selection(
                settings.namespace,
                (*topics, *more_topics),
                streams,
                frames,
                regex,
                _excluding(settings.namespace, exclude, exclude_topics),
            ),
            everywhere=fleet,
            splits=Splits(max_bytes, max_s),
            compression=compression,
            cache_bytes=cache_bytes or (_SNAPSHOT_CACHE_BYTES if snapshot_s else _CACHE_BYTES),
            snapshot_s=snapshot_s,
            conditions=tuple(map(Condition.parse, conditions)),
            with_history=with_history,
            starts_paused=starts_paused,
            has_keys=not no_keys,
        )
    except TfbusError as error:
        raise click.UsageError(str(error)) from error
    try:
        import mcap.writer  # noqa: F401
    except ImportError as error:
        raise TfbusError(
            f"recordings need mcap, which is not installed: {install_command('bag')}"
        ) from error
    failure = _record(settings, plan)
    if failure:
        raise click.ClickException(failure)


def _free_path(output: str | None) -> Path:
    path = path_of_recording(output)
    if not path.parent.is_dir():
        raise InvalidArgumentException(
            f"there is no folder '{printable(str(path.parent))}' to record into"
        )
    taken = existing_parts(path)
    if taken:
        raise InvalidArgumentException(
            f"'{printable(str(taken[0]))}' is there already, and recordings are never overwritten: "
            "give another name (-o)"
        )
    return path


def _selection(
    namespace: str,
    topics: tuple[str, ...],
    streams: tuple[str, ...],
    frames: tuple[str, ...],
    regex: str,
    exclude: str,
) -> Selection:
    topics = tuple(_full(topic, namespace) for topic in topics)
    for topic in topics:
        if not is_of_transforms(topic):
            check_no_transforms(topic)
    names = tuple(_full(stream, namespace) for stream in streams)
    return Selection(topics, names, frames, regex, exclude)


def _full(name: str, namespace: str) -> str:
    """A name as a session without a namespace has it."""
    return name[1:] if name.startswith("/") else "/".join(filter(None, (namespace, name)))


def _excluding(namespace: str, exclude: str, topics: tuple[str, ...]) -> str:
    names = [f"^{re.escape(_full(topic, namespace))}$" for topic in topics]
    return "|".join([*filter(None, (exclude,)), *names])


def _record(settings: NodeSettings, plan: _Plan) -> str:
    """Record until Ctrl-C; why it failed, "" where it did not."""
    line = StatusLine()
    queue = RawQueue(plan.cache_bytes)
    parts = PartsWritten(plan.path, lambda path: _open_writer(path, settings, plan))
    with Node.from_settings(settings) as node, ExitStack() as stack:
        node.log.addFilter(line.clear)
        node.session.settle()
        past = None
        if plan.with_history:
            executor = Executor("history", node.log)
            stack.callback(executor.close)
            past = Past(node.session, executor)
        capture = Capture(
            node,
            queue,
            plan.selection,
            everywhere=plan.everywhere,
            on_stream=past.meet if past else lambda state: None,
        )
        try:
            recorder = _recorder(node, plan, queue, parts, past, capture)
        except OSError as error:
            capture.close()
            return f"could not record to '{printable(str(plan.path))}': {error.strerror or error}"
        try:
            if plan.starts_paused:
                recorder.pause()
            with suppress(KeyboardInterrupt):  # the usual end
                _go_on(node, plan, recorder, parts, line)
        finally:
            line.clear()
            capture.close()
            recorder.close()
        line.clear()
        lost = recorder.counts.lost + Counter(_too_large(node))
    counts = recorder.counts
    _print_end(
        summary(
            parts.paths,
            time.monotonic() - recorder.began_s,
            counts.transforms,
            counts.streams,
            counts.topics,
            lost,
        )
    )
    if not recorder.failure:
        return ""
    return (
        f"stopped recording: {recorder.failure}; what was written until then is in "
        f"{listed([printable(str(path)) for path in parts.paths[-2:]])}"
    )


def _recorder(
    node: Node,
    plan: _Plan,
    queue: RawQueue,
    parts: PartsWritten,
    past: Past | None,
    capture: Capture,
) -> Recorder:
    snapshots = None
    if plan.snapshot_s is not None:
        snapshots = Snapshots(plan.snapshot_s, plan.cache_bytes, Triggers(plan.conditions))
    return Recorder(
        queue,
        parts,
        node.log,
        selection=plan.selection,
        splits=plan.splits,
        snapshots=snapshots,
        past=past,
        source=capture.source,
        on_file=lambda path, why: node.log.info(_news(path, why, snapshots is not None)),
    )


def _news(path: Path, why: str, is_snapshot: bool) -> str:
    if not is_snapshot:
        return f"Goes on in {path}"
    return f"Wrote {path}" if why == "asked" else f"Wrote {path}: {why}"


def _open_writer(path: Path, settings: NodeSettings, plan: _Plan) -> RecordingWriter:
    about = {
        "host": socket.gethostname(),
        "namespace": settings.namespace,
        "command": printable(shlex.join(["tfbus", *sys.argv[1:]]), 1000),
        "began": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
    }
    return RecordingWriter(path, compression=plan.compression, about=about)


def _too_large(node: Node) -> dict[str, int]:
    count = sum(node.session.callbacks.too_large.values())
    return {"too large": count} if count else {}


def _serve(node: Node, recorder: Recorder, stop: Callable[[], object], *, snapshots: bool) -> None:
    """The services of a recorder, as keys do."""

    def split(wants_snapshot: bool) -> None:
        if snapshots and not wants_snapshot:
            raise ServiceError("with --snapshot nothing is split: call recorder/snapshot")
        if wants_snapshot and not snapshots:
            raise ServiceError("it records everything: start it with --snapshot SECONDS")
        recorder.split()

    jobs: dict[str, Callable[[], object]] = {
        "pause": recorder.pause,
        "resume": recorder.resume,
        "split": lambda: split(False),
        "snapshot": lambda: split(True),
        "stop": stop,
    }

    def serving(job: Callable[[], object]) -> Callable[[Empty.Request], Empty.Response]:
        def serve(request: Empty.Request) -> Empty.Response:
            job()
            return Empty.Response()

        return serve

    for name, job in jobs.items():
        node.create_service(Empty, f"~/{name}", serving(job))


def _go_on(
    node: Node, plan: _Plan, recorder: Recorder, parts: PartsWritten, line: StatusLine
) -> None:
    """Show how it goes and follow keys, until Ctrl-C, `stop`, or a failure."""
    _serve(node, recorder, node.shutdown, snapshots=plan.snapshot_s is not None)
    what = (
        f"Holding the last {plan.snapshot_s:g} s"
        if plan.snapshot_s
        else f"Recording to {plan.path}"
    )
    rating = Rating()
    shows = is_terminal()
    logged_s = began_s = recorder.began_s
    was_silent = False
    with _keys(plan.has_keys and shows) as read_keys:
        node.ready(f"{what}{f'; {_KEYS[bool(plan.snapshot_s)]}' if read_keys else ''}")
        while node.ok and recorder.is_running:
            if read_keys is None:
                if not node.wait(_LOOK_EVERY_S, clock=SYSTEM_CLOCK):
                    return
            elif not _follow(read_keys(), recorder, bool(plan.snapshot_s)):
                return
            look = _look(node, recorder, parts)
            rates = rating.add(look)
            if shows:
                line.show(status_parts(look, rates, look.at_s - began_s), warns=look.lost > 0)
            elif look.at_s >= logged_s + _LOG_EVERY_S:
                logged_s = look.at_s
                node.log.info(log_text(look, rates))
            if not was_silent and look.at_s > began_s + _SILENT_S:
                was_silent = True
                _warn_of_silence(node, recorder, plan)


def _look(node: Node, recorder: Recorder, parts: PartsWritten) -> Look:
    counts, window = recorder.counts, recorder.window
    lost = counts.lost.total() + sum(_too_large(node).values())
    return Look(
        time.monotonic(),
        recorder.received,
        counts.transforms,
        parts.all_bytes,
        parts.free_bytes,
        lost,
        recorder.is_paused,
        None if window is None else (window.bytes, window.kept_s),
        len(parts.paths),
    )


def _warn_of_silence(node: Node, recorder: Recorder, plan: _Plan) -> None:
    """Say what may be wrong where nothing has come so far."""
    if recorder.is_paused or recorder.is_waiting:
        return
    missing = [
        topic
        for topic in plan.selection.topics
        if topic not in recorder.counts.topics and not is_of_transforms(topic)
    ]
    if missing and not recorder.window:
        node.log.warning("No message on topic %s so far", listed(missing))
    elif not recorder.received:
        hint = ""
        if not plan.everywhere:
            hint = where_to_look(frames_in_other_namespaces(node.session))
        node.log.warning(
            "Nothing to record so far: %s", hint or "is a broadcaster running, on this network?"
        )


@contextmanager
def _keys(wanted: bool) -> Iterator[Callable[[], list[str]] | None]:
    """Inside the `with`, a function that returns the keys typed within 0.25 s; None without a
    terminal of its own.
    """
    if not wanted or not _is_own_terminal():
        yield None
        return
    reader = KeyReader()
    with RawTerminal(_STANDARD_INPUT) as terminal, _hanging_up():

        def read() -> list[str]:
            try:
                data = terminal.read(_LOOK_EVERY_S)
            except NoTerminalError:
                return ["q"]
            return reader.feed(data) if data else reader.flush()

        yield read


def _is_own_terminal() -> bool:
    """Whether standard input is a terminal whose foreground job this is: reading from the
    background would stop the process.
    """
    with suppress(OSError):
        return os.isatty(_STANDARD_INPUT) and os.tcgetpgrp(_STANDARD_INPUT) == os.getpgrp()
    return False


@contextmanager
def _hanging_up() -> Iterator[None]:
    """Inside the `with`, a terminal that goes away (ssh, a closed window) ends the recording as
    Ctrl-C does, so that its file is whole.
    """

    def end(number: int, frame: object) -> None:
        _print_nothing_further()
        raise KeyboardInterrupt

    previous = signal.signal(signal.SIGHUP, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGHUP, previous)


def _print_nothing_further() -> None:
    nothing = os.open(os.devnull, os.O_WRONLY)
    for stream in (1, 2):
        os.dup2(nothing, stream)


def _follow(keys: list[str], recorder: Recorder, snapshots: bool) -> bool:
    """Do what keys are for; whether to go on."""
    for key in keys:
        if key in ("q", "Q", "\x03"):
            return False
        if key == " " and not snapshots:
            (recorder.resume if recorder.is_paused else recorder.pause)()
        elif key in ("s", "S"):
            recorder.split_later()
    return True


def _print_end(lines: list[str]) -> None:
    try:
        print_lines(lines)
    except OSError as error:  # a full disk, where stdout is a file
        warn(error)
