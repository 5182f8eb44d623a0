"""Runs a recorder on the bus by the plan of its options: shows how it goes, serves."""

import os
import shlex
import socket
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from contextlib import ExitStack, nullcontext, suppress
from dataclasses import dataclass
from pathlib import Path

from tfbus.bag.capture import Capture
from tfbus.bag.filling import Filling
from tfbus.bag.keeping import (
    Keep,
    PartsWritten,
    Splits,
    WrittenPart,
    existing_parts,
    is_folder,
    path_of_recording,
)
from tfbus.bag.kept import KEPT, KeptFiles, alone_in, kept_files
from tfbus.bag.raw_queue import Past, RawQueue
from tfbus.bag.recorder import MISSING, Recorder, SnapshotCondition, Snapshots, Triggers, unmatched
from tfbus.base.clock import SYSTEM_CLOCK
from tfbus.base.errors import InvalidArgumentException, RightsError, ServiceError
from tfbus.base.executor import Executor
from tfbus.base.wording import duration, listed, printable
from tfbus.bus.graph import where_to_look
from tfbus.bus.presence import bus_out_of_reach, frames_in_other_namespaces
from tfbus.bus.settings import NodeSettings
from tfbus.cli.bag.record_status import (
    LogPace,
    Rating,
    RecordCounts,
    StatusLine,
    length_text,
    log_text,
    status_parts,
    summary,
)
from tfbus.cli.bus import is_running
from tfbus.cli.output import is_terminal, print_lines, warn
from tfbus.command.terminal import typed_keys
from tfbus.messages import Empty, SaveRecording
from tfbus.node.node import Node
from tfbus.recording.items import RECORDING, Selection, is_of_transforms, lacks_statics
from tfbus.recording.layout import CUSTOM
from tfbus.recording.writer import Compression, RecordingWriter
from tfbus.wire.keys import check_no_transforms
from tfbus.wire.limits import size_text

_LOOK_EVERY_S = 0.5

# If nothing has come after this time, it names the topics that it waits for.
_SILENT_S = 3.0

# With the 5 ms of Python, 20,000 messages a second came slower than they were sent.
_SWITCH_S = 1e-4

_KEYS = {False: "space pauses, s begins a new file, q ends", True: "s writes a snapshot, q ends"}


# The most bytes that wait to be written, and that are held for a snapshot.
_CACHE_BYTES = 100_000_000
_SNAPSHOT_CACHE_BYTES = 500_000_000


@dataclass(frozen=True)
class RecordPlan:
    """The plan of a recording. `cache_bytes` is how much may wait to be written, or is held for a
    snapshot; None is 100 MB, or 500 MB for a snapshot. With `keep` it serves its files, and goes
    on with the files in its folder.
    """

    path: Path
    selection: Selection
    everywhere: bool
    splits: Splits
    compression: Compression
    cache_bytes: int | None
    snapshot_s: float | None
    conditions: tuple[SnapshotCondition, ...]
    with_history: bool
    starts_paused: bool
    has_keys: bool
    most_files: int | None
    keep: Keep | None
    custom_data: Mapping[str, str]

    @property
    def most_bytes(self) -> int:
        """How much may wait, or is held."""
        return self.cache_bytes or (_SNAPSHOT_CACHE_BYTES if self.snapshot_s else _CACHE_BYTES)


def free_path(output: str | None) -> Path:
    """The file to write. Raises InvalidArgumentException if it, or a part of it, is there."""
    path = path_of_recording(output)
    if output is not None and is_folder(output):
        _make_folder(path.parent)
    elif not path.parent.is_dir():
        raise InvalidArgumentException(
            f"there is no folder '{printable(str(path.parent))}' to record into: make it, or end "
            "its name with '/' and have a file in it named by the time"
        )
    taken = existing_parts(path)
    if taken:
        raise InvalidArgumentException(
            f"'{printable(str(taken[0]))}' is there already, and recordings are never overwritten: "
            "give another name (-o)"
        )
    return path


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InvalidArgumentException(
            f"could not make the folder '{printable(str(folder))}': {error.strerror or error}"
        ) from error


def pairs_of(texts: Iterable[str]) -> dict[str, str]:
    """The pairs in texts such as `driver=Ada`; of a key that comes twice the last counts.

    Raises InvalidArgumentException for another form.
    """
    pairs = {}
    for text in texts:
        key, sign, value = text.partition("=")
        if not (key and sign and text.isprintable()):
            raise InvalidArgumentException(f"'{printable(text, 60)}' is not of the form KEY=VALUE")
        pairs[key] = value
    return pairs


def checked(selection: Selection) -> Selection:
    """The selection. Raises InvalidNameError for a topic that no node can have."""
    for topic in selection.topics:
        if not is_of_transforms(topic):
            check_no_transforms(topic)
    return selection


def record(settings: NodeSettings, plan: RecordPlan) -> str:
    """Record until Ctrl-C; why it failed, "" if it did not.

    Raises TfbusError if another recorder keeps its files in the folder.
    """
    with nullcontext() if plan.keep is None else alone_in(plan.path.parent):
        return _record(settings, plan)


def _record(settings: NodeSettings, plan: RecordPlan) -> str:
    # Zenoh's threads take a message each time they get the interpreter from the thread that writes.
    sys.setswitchinterval(_SWITCH_S)
    token = os.urandom(8).hex()
    parts = PartsWritten(
        plan.path,
        lambda path: _open_writer(path, settings, plan, token),
        most_files=plan.most_files,
        keep=plan.keep,
        older=kept_files(plan.path.parent) if plan.keep is not None else (),
    )
    recorder = capture = None
    unfilled: list[str] = []
    with Node.from_settings(settings) as node, ExitStack() as stack:
        line = StatusLine()
        node.log.addFilter(line.clear)
        node.session.settle()
        try:
            with suppress(KeyboardInterrupt):  # the usual end
                recorder, capture = _recorder(node, plan, parts, stack)
                if plan.starts_paused:
                    recorder.pause()
                filling = _filling(node, plan, recorder, capture, parts, stack)
                stack.callback(lambda: unfilled.extend(filling.unfilled() if filling else ()))
                _go_on(node, plan, recorder, capture, parts, line, filling)
        except OSError as error:
            if recorder is not None:
                raise
            return f"could not record to '{printable(str(plan.path))}': {error.strerror or error}"
        finally:
            line.clear()
            stack.close()
    if recorder is None or capture is None:
        return ""  # Ctrl-C came before it began
    _print_end(recorder, parts, _lost(recorder, node))
    for clause in unfilled:
        warn(clause)
    for clause in _unmatched(plan, recorder, capture):
        warn(f"In the end {clause}")
    if not recorder.failure:
        return ""
    return (
        f"stopped recording: {recorder.failure}; what was written until then is in "
        f"{listed([printable(str(path)) for path in parts.paths[-2:]])}"
    )


def _recorder(
    node: Node, plan: RecordPlan, parts: PartsWritten, stack: ExitStack
) -> tuple[Recorder, Capture]:
    """A recorder by the plan, and its capture; both end with the stack."""
    queue = RawQueue(plan.most_bytes)
    past = None
    if plan.with_history:
        executor = Executor("history", node.log)
        stack.callback(executor.close)
        past = Past(node.session, executor, plan.most_bytes)
    capture = Capture(
        node,
        queue,
        plan.selection,
        everywhere=plan.everywhere,
        on_stream=past.meet if past else lambda state: None,
    )
    snapshots = None
    if plan.snapshot_s is not None:
        snapshots = Snapshots(plan.snapshot_s, plan.most_bytes, Triggers(plan.conditions))
    recorder = Recorder(
        queue,
        parts,
        node.log,
        selection=plan.selection,
        splits=plan.splits,
        snapshots=snapshots,
        past=past,
        source=capture.source,
        on_file=lambda path, written, why: node.log.info(
            _news(path, written, why, is_snapshot=snapshots is not None)
        ),
    )
    stack.callback(recorder.close)
    stack.callback(capture.close)
    return recorder, capture


def _filling(
    node: Node,
    plan: RecordPlan,
    recorder: Recorder,
    capture: Capture,
    parts: PartsWritten,
    stack: ExitStack,
) -> Filling | None:
    """Serves the kept files; or fills gaps from recorders that do, except of snapshots."""
    if plan.keep is not None:
        try:
            kept = KeptFiles(node, parts)
        except RightsError as error:
            node.log.warning("What is kept is not served: %s", error)
        else:
            stack.callback(kept.close)
        return None
    if plan.snapshot_s is not None:
        return None
    filling = Filling(
        node.session, capture, recorder, plan.selection, everywhere=plan.everywhere, log=node.log
    )
    stack.callback(filling.close)
    return filling


def _news(path: Path, written: WrittenPart, why: str, *, is_snapshot: bool) -> str:
    of, length = f"Wrote {printable(str(written.path))}", length_text(written)
    if not is_snapshot:
        return f"{of}: {length}; goes on in {printable(str(path))}"
    return f"{of}: {length}" if why == "asked" else f"{of}: {why}; {length}"


def _open_writer(
    path: Path, settings: NodeSettings, plan: RecordPlan, token: str
) -> RecordingWriter:
    about = {
        # Between snapshots nothing is recorded: each is a recording of its own.
        RECORDING: token if plan.snapshot_s is None else os.urandom(8).hex(),
        "host": socket.gethostname(),
        **({KEPT: "true"} if plan.keep is not None else {}),
        "namespace": settings.namespace,
        "command": printable(shlex.join(["tfbus", *sys.argv[1:]]), 1000),
        "began": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
        **{f"{CUSTOM}{key}": value for key, value in plan.custom_data.items()},
    }
    return RecordingWriter(path, compression=plan.compression, about=about)


def _lost(recorder: Recorder, node: Node) -> Counter[str]:
    """How many messages were not recorded, by the cause."""
    too_large = sum(node.session.callbacks.too_large.values())
    return recorder.counts.lost + Counter({"too large": too_large})


def _serve(node: Node, recorder: Recorder, stop: Callable[[], object], *, snapshots: bool) -> None:
    """The services of a recorder, as keys do."""

    def split(request: SaveRecording.Request) -> SaveRecording.Response:
        if snapshots:
            raise ServiceError("with --snapshot nothing is split: call recorder/snapshot")
        return save()

    def snapshot(request: SaveRecording.Request) -> SaveRecording.Response:
        if not snapshots:
            raise ServiceError("it records everything: start it with --snapshot SECONDS")
        return save()

    def save() -> SaveRecording.Response:
        written = recorder.split()
        path = printable(str(written.path.absolute()), 4000)
        return SaveRecording.Response(path, written.seconds, written.size)

    node.create_service(SaveRecording, "~/split", split)
    node.create_service(SaveRecording, "~/snapshot", snapshot)
    jobs: dict[str, Callable[[], object]] = {
        "pause": recorder.pause,
        "resume": recorder.resume,
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
    node: Node,
    plan: RecordPlan,
    recorder: Recorder,
    capture: Capture,
    parts: PartsWritten,
    line: StatusLine,
    filling: Filling | None,
) -> None:
    """Show how it goes and follow keys, until Ctrl-C, `stop`, or a failure."""
    try:
        _serve(node, recorder, node.shutdown, snapshots=plan.snapshot_s is not None)
    except RightsError as error:
        # Who only reads may record all the same.
        node.log.info("No services pause or split this recording: %s", error)
    what = _purpose(plan)
    if lacks_statics(plan.selection):
        node.log.info("Static transforms are left out: --topics tf tf_static has them too")
    rating = Rating()
    shows = is_terminal()
    began_s = recorder.began_s
    pace = LogPace(began_s)
    was_silent = False
    with typed_keys(_LOOK_EVERY_S, wanted=plan.has_keys and shows) as read_keys:
        node.ready(f"{what}{f'; {_KEYS[bool(plan.snapshot_s)]}' if read_keys else ''}")
        while node.ok and recorder.is_running:
            if read_keys is None:
                if not node.wait(_LOOK_EVERY_S, clock=SYSTEM_CLOCK):
                    return
            elif not _follow(read_keys(), recorder, bool(plan.snapshot_s)):
                return
            look = _look(node, recorder, parts, filling)
            rates = rating.add(look)
            if shows:
                line.show(status_parts(look, rates, look.at_s - began_s), warns=look.lost > 0)
            elif pace.is_due(look):
                node.log.info(log_text(look, rates))
            if not was_silent and look.at_s > began_s + _SILENT_S:
                was_silent = True
                _warn_of_silence(node, recorder, plan)
                for clause in _unmatched(plan, recorder, capture):
                    node.log.warning("So far %s", clause)


def _purpose(plan: RecordPlan) -> str:
    """The work of a recorder, as a clause."""
    if plan.snapshot_s:
        return f"Holding the last {plan.snapshot_s:g} s"
    if plan.keep is None:
        return f"Recording to {plan.path}"
    last_s, most_bytes = plan.keep.last_s, plan.keep.most_bytes
    kept = duration(last_s) if most_bytes is None else size_text(most_bytes)
    return f"Keeping the last {kept} in {plan.path.parent}, and serving them"


def _look(
    node: Node, recorder: Recorder, parts: PartsWritten, filling: Filling | None
) -> RecordCounts:
    counts, window = recorder.counts, recorder.window
    lost = _lost(recorder, node)
    missing = lost.pop(MISSING, 0)
    return RecordCounts(
        time.monotonic(),
        recorder.received,
        counts.transforms,
        parts.written_bytes,
        parts.free_bytes,
        lost.total(),
        recorder.is_paused,
        None if window is None else (window.bytes, window.kept_s),
        len(parts.paths),
        () if filling is None else tuple(filling.progress()),
        missing,
    )


def _warn_of_silence(node: Node, recorder: Recorder, plan: RecordPlan) -> None:
    """Warn with a possible cause if nothing has come so far."""
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
        hint = hint or bus_out_of_reach(node.session)
        node.log.warning("Nothing to record so far: %s", hint or is_running("broadcaster"))


def _unmatched(plan: RecordPlan, recorder: Recorder, capture: Capture) -> list[str]:
    """A clause for each name that is asked for, and that nothing had."""
    if not capture.described:
        return []  # nothing is there, which is said
    received = [*recorder.counts.streams]
    return [*unmatched(plan.selection, plan.conditions, dict(capture.described), received)]


def _follow(keys: list[str], recorder: Recorder, snapshots: bool) -> bool:
    """Follow keys; whether to go on."""
    for key in keys:
        if key in ("q", "Q", "\x03"):
            return False
        if key == " " and not snapshots:
            (recorder.resume if recorder.is_paused else recorder.pause)()
        elif key in ("s", "S"):
            recorder.split_later()
    return True


def _print_end(recorder: Recorder, parts: PartsWritten, lost: Counter[str]) -> None:
    counts = recorder.counts
    try:
        print_lines(
            summary(
                parts.written,
                counts.transforms,
                len(counts.statics),
                counts.streams,
                counts.topics,
                lost,
                deleted=parts.deleted,
            )
        )
    except OSError as error:  # a full disk, where stdout is a file
        warn(error)
