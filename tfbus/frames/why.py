"""Why a lookup fails, or would fail, on a bus or in a recording: its path, edge by edge."""

from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Literal

from tfbus.base.errors import (
    ConnectivityException,
    ExtrapolationException,
    LookupException,
    TfbusError,
    TransformException,
)
from tfbus.base.wording import counted, duration, natural_order, near_names
from tfbus.buffer.buffer import Buffer
from tfbus.buffer.info import FrameInfo
from tfbus.frames.clocks import is_another_time
from tfbus.frames.fleet import RobotStatus
from tfbus.frames.moment import BusMoment, facts, is_stale, silent_s
from tfbus.frames.recorded import RecordedFrames, S
from tfbus.frames.recorded_poses import transform_then
from tfbus.frames.snapshot import (
    FrameTree,
    Problem,
    ProblemKind,
    stamp_when_measured,
    synchronize,
    who,
    why_unreadable,
)
from tfbus.geometry.transform import TransformStamped
from tfbus.streams.info import StreamInfo
from tfbus.wire.fleet import shared_name

Verdict = Literal["ok", "warn", "fail"]

# Clocks that differ by more than this make stamps look late, or in the future.
_CLOCKS_AGREE_S = 0.05

# A remedy names at most this many namespaces.
_NAMED = 3

# Where a problem near the path has an advice of its own; others are named edge by edge.
_ADVISED: tuple[ProblemKind, ...] = ("loop", "conflict", "silent", "clock", "unit")


class Advice:
    """The remedies on a bus, sentence by sentence; "" if there is nothing to be done."""

    def failure(self, error: TransformException) -> str:
        """The message of an error."""
        return str(error)

    def on_gone(self, frame: FrameInfo, stream: StreamInfo) -> str:
        """The publisher of a frame is gone."""
        return f"start the publisher of {frame.name!r} again: {who(stream)}"

    def on_stale(self, frame: FrameInfo, stream: StreamInfo) -> str:
        """A frame comes no longer."""
        return f"check that {who(stream)} still sends {frame.name!r}: tfbus topic hz tf"

    def on_no_sample(self, frame: FrameInfo, stream: StreamInfo) -> str:
        """A frame is listed, and has not come."""
        if stream.unreadable:
            return why_unreadable(stream)
        return f"wait for {who(stream)} to send {frame.name!r}"

    def on_unknown(self, frame: str) -> str:
        """There is no frame of that name, nor of one like it."""
        return f"start the node that publishes {frame!r}"

    def on_apart(self, target_root: str, source_root: str) -> str:
        """The frames are in two trees with these roots."""
        return f"publish a transform between {target_root!r} and {source_root!r}"

    def on_problem(self, problem: Problem) -> str:
        """A problem of the tree."""
        return problem.remedy if problem.kind in _ADVISED else ""


ON_THE_BUS = Advice()


class FleetAdvice(Advice):
    """The remedies in a fleet, where an unknown frame may be of a robot that is not there.

    `robots` are there, gone or missing; a `roster` are the names of expected robots, () for any.
    """

    def __init__(self, robots: Iterable[RobotStatus], roster: Collection[str] = ()) -> None:
        self._states = {robot.name: robot.state for robot in robots}
        self._roster = roster

    def on_unknown(self, frame: str) -> str:
        robot = self._robot(frame)
        state = self._states.get(robot)
        if not robot or state == "there":
            return super().on_unknown(frame)
        if state == "gone":
            return f"start robot {robot!r} again, or check its link: it is gone"
        if state == "missing":
            return f"start robot {robot!r}, or check its link: it is missing"
        if self._roster:
            near = near_names(robot, self._roster)
            meant = f"; did you mean {' or '.join(map(repr, near))}?" if near else ""
            return f"check the name of robot {robot!r}, which is not in the roster{meant}"
        return f"start robot {robot!r}, or check its link: no node of it is here (tfbus fleet)"

    def _robot(self, frame: str) -> str:
        """The robot of a frame by its name in the fleet; "" for a frame that robots share."""
        above = frame
        while above := above.rpartition("/")[0]:
            if above in self._states:
                return above
        return frame.partition("/")[0] if "/" in frame else ""


@dataclass(frozen=True)
class Step:
    """An edge of the path: its facts, and its worst problem for this lookup.

    "warn" does not make the lookup fail, but is a bad sign; `reason` and `remedy` are "" when the
    verdict is "ok".
    """

    parent: str
    child: str
    facts: tuple[str, ...]
    verdict: Verdict = "ok"
    reason: str = ""
    remedy: str = ""


@dataclass(frozen=True)
class Explanation:
    """The result of a lookup of `source` seen from `target` at a stamp (None: the latest).

    `failure` is the message of the error, "" when there is an `answer`; `age_s` is that of the
    latest one by the moment that the steps are of, None if all is static. `steps` lead from the
    target to the source or, when they are not connected, from each to its root. `remedies` are
    sentences, the most likely first.
    """

    target: str
    source: str
    stamp_ns: int | None
    answer: TransformStamped | None
    failure: str
    steps: tuple[Step, ...]
    remedies: tuple[str, ...]
    age_s: float | None = None
    # The subscriptions whose messages wait for this lookup, of each its node and counts.
    filters: tuple[str, ...] = ()


def explain(
    moment: BusMoment,
    buffer: Buffer,
    target: str,
    source: str,
    stamp_ns: int | None = None,
    *,
    frames_in_other_namespaces: Collection[tuple[str, str]] = (),
    advice: Advice = ON_THE_BUS,
    reads_only: str = "",
) -> Explanation:
    """Explain the lookup in this buffer; `moment` is of the same time.

    `frames_in_other_namespaces` are pairs of (namespace, frame) for the frames of other namespaces.
    `reads_only` is the namespace that our identity on a closed bus may read, "" for all.
    """
    tree = moment.tree
    children = _children(tree, target, source)
    answer, error = _look_up(buffer, target, source, stamp_ns, _newest_ns(tree, children))
    steps = tuple(_judge(tree, child, stamp_ns, advice) for child in children)
    near = {target, source, *children}
    remedies = [
        *_remedies_of_rights(tree, error, reads_only),
        *_remedies_of_unreadable(tree, error),
        *_remedies_of(tree, error, frames_in_other_namespaces, advice),
        *(step.remedy for step in steps if step.verdict == "fail"),
        *(step.remedy for step in steps if step.verdict == "warn"),
        *_remedies_of_problems(tree, near, error, advice),
    ]
    return Explanation(
        target,
        source,
        stamp_ns,
        answer,
        advice.failure(error) if error else "",
        steps,
        tuple(dict.fromkeys(filter(None, remedies))),
        (tree.recorded_ns - answer.stamp_ns) / 1e9
        if answer and answer.stamp_ns and stamp_ns is None
        else None,
    )


def _look_up(
    buffer: Buffer, target: str, source: str, stamp_ns: int | None, newest_ns: int | None
) -> tuple[TransformStamped | None, TransformException | None]:
    """The lookup; the latest one as of `newest_ns`, since samples come while we look."""
    try:
        answer = buffer.lookup_transform(target, source, stamp_ns)
        if stamp_ns is None and newest_ns is not None and answer.stamp_ns > newest_ns:
            with suppress(TransformException):  # a frame has changed its parent meanwhile
                answer = buffer.lookup_transform(target, source, newest_ns)
        return answer, None
    except TransformException as error:
        return None, error


def _newest_ns(tree: FrameTree, children: Iterable[str]) -> int | None:
    """The newest stamp that all moving edges have, by the tree; None if none moves."""
    newest = [tree.frames[each].newest_ns for each in children if not tree.frames[each].static]
    return min(filter(None, newest), default=None)


def _children(tree: FrameTree, target: str, source: str) -> list[str]:
    """The children of the edges between the two or, when not connected, of all edges above them."""
    up, down = _chain(tree, target), _chain(tree, source)
    while up and down and up[-1] == down[-1]:
        up.pop()
        down.pop()
    return [name for name in (*up, *reversed(down)) if tree.frames[name].parent is not None]


def _chain(tree: FrameTree, frame: str) -> list[str]:
    """The frame and all above it; empty for an unknown frame."""
    chain: list[str] = []
    at: str | None = frame
    while at is not None and at in tree.frames:
        chain.append(at)
        at = tree.frames[at].parent
    return chain


def _judge(tree: FrameTree, child: str, stamp_ns: int | None, advice: Advice) -> Step:
    frame = tree.frames[child]
    step = Step(frame.parent or "", child, tuple(facts(tree, frame)))
    for verdict, reason, remedy in _faults(tree, frame, stamp_ns, advice):
        return replace(step, verdict=verdict, reason=reason, remedy=remedy)
    if child in tree.conflicts:
        return replace(step, verdict="warn", reason="the answer is from one of its publishers")
    return step


def _faults(
    tree: FrameTree, frame: FrameInfo, stamp_ns: int | None, advice: Advice
) -> Iterator[tuple[Verdict, str, str]]:
    """The problems of an edge, the worst first: verdict, reason, remedy."""
    stream = tree.publisher(frame)
    if tree.no_stamps(frame):
        # Its facts show the stamps, and the problem of the tree has the remedy.
        yield "warn" if stamp_ns is None else "fail", "no lookup at a time finds its samples", ""
    if not frame.static:
        yield from _out_of_time(tree, frame, stamp_ns, advice)
    if tree.is_of_another_time(frame):
        yield "warn", "its stamps are of a simulated time, and this tool uses the system's", ""
    if frame.gone:
        yield (
            "warn",
            "its publisher is gone, and its last pose is no longer updated",
            advice.on_gone(frame, stream),
        )
    elif is_stale(tree, frame):
        yield (
            "warn",
            f"no sample for {duration(silent_s(tree, frame))}",
            advice.on_stale(frame, stream),
        )
    if stream.clock_offset_s is not None and abs(stream.clock_offset_s) > _CLOCKS_AGREE_S:
        yield "warn", _skew(stream), synchronize(stream)
    elif _is_all_ahead(tree, frame):
        yield (
            "warn",
            "all its samples are in the future: no lookup at the present time finds one",
            stamp_when_measured(stream, [frame.name]),
        )
    elif (late_s := tree.late_s(frame)) is not None:
        yield (
            "warn",
            f"its samples come {duration(late_s)} after their stamps: no lookup at the present "
            "time finds one",
            stamp_when_measured(stream, [frame.name]),
        )


def _out_of_time(
    tree: FrameTree, frame: FrameInfo, stamp_ns: int | None, advice: Advice
) -> Iterator[tuple[Verdict, str, str]]:
    stream = tree.publisher(frame)
    if frame.oldest_ns is None or frame.newest_ns is None:
        yield "fail", "it has no sample", advice.on_no_sample(frame, stream)
    elif stamp_ns is None:
        return
    elif stamp_ns < frame.oldest_ns:
        yield (
            "fail",
            f"the time is {duration((frame.oldest_ns - stamp_ns) / 1e9)} before its oldest sample",
            stamp_when_measured(stream, [frame.name])
            if _is_all_ahead(tree, frame)
            else "query a later time: no publisher has kept older samples",
        )
    elif stamp_ns > frame.newest_ns:
        beyond = duration((stamp_ns - frame.newest_ns) / 1e9)
        wait = "wait for it (timeout_s), or query the latest"
        yield (
            "fail",
            f"the time is {beyond} after its newest sample",
            advice.on_gone(frame, stream) if frame.gone else wait,
        )


def _is_all_ahead(tree: FrameTree, frame: FrameInfo) -> bool:
    """Whether all samples of a frame are in the future, by the time that this tool follows."""
    if frame.oldest_ns is None or is_another_time(tree.age_s(frame)):
        return False
    return tree.is_ahead(frame) and frame.oldest_ns > tree.recorded_ns


def _skew(stream: StreamInfo) -> str:
    offset_s = stream.clock_offset_s or 0.0
    side = "ahead of" if offset_s > 0 else "behind"
    return f"the clock of its publisher is {duration(abs(offset_s))} {side} ours"


def _remedies_of(
    tree: FrameTree,
    error: TransformException | None,
    frames_in_other_namespaces: Collection[tuple[str, str]],
    advice: Advice,
) -> Iterator[str]:
    if isinstance(error, LookupException):
        yield from _remedies_in_other_namespaces(error.frame, frames_in_other_namespaces)
        yield (
            f"use {error.nearest[0]!r} if you mean that"
            if error.nearest
            else advice.on_unknown(error.frame)
        )
    if isinstance(error, ConnectivityException) and error.target_root != error.source_root:
        if name := shared_name(error.target_root, error.source_root):
            yield f"if the robots share {name!r}, pass --shared {name}"
        else:
            yield tree.ask_if_slip(error.source_root, error.target_root)
        yield advice.on_apart(error.target_root, error.source_root)


def _remedies_of_rights(
    tree: FrameTree, error: TransformException | None, reads_only: str
) -> Iterator[str]:
    """For frames that are not there, perhaps by the rights of a closed bus."""
    if not isinstance(error, (LookupException, ConnectivityException)):
        return
    for stream in tree.streams.values():
        if stream.forbidden:
            yield (
                f"{who(stream)} sent {counted(stream.forbidden, 'transform')} of frames that its "
                "identity may not publish: add the frame to its 'frames' in rights.yaml, if it may"
            )
    if reads_only and isinstance(error, LookupException):
        yield (
            f"this identity reads only the namespace {reads_only!r}: if {error.frame!r} is in "
            "another, look by an identity that reads that"
        )


def _remedies_of_unreadable(tree: FrameTree, error: TransformException | None) -> Iterator[str]:
    """For frames that are not there, perhaps as their stream's description is unreadable."""
    if isinstance(error, (LookupException, ConnectivityException)):
        for stream in tree.streams.values():
            if stream.alive and stream.unreadable and not stream.frames:
                yield why_unreadable(stream)


def _remedies_in_other_namespaces(
    frame: str, frames_in_other_namespaces: Collection[tuple[str, str]]
) -> Iterator[str]:
    """For a frame of the namespaces below, by its own name or as a fleet names it."""
    if frame in {f"{namespace}/{name}" for namespace, name in frames_in_other_namespaces}:
        yield "look at all robots together: --fleet"
    namespaces = sorted(
        (namespace for namespace, name in frames_in_other_namespaces if name == frame),
        key=natural_order,
    )
    if namespaces:
        yield (
            f"look from within its namespace, which has {frame!r}: "
            f"--namespace {' or '.join(namespaces[:_NAMED])}"
        )
        yield f"look at all robots together, where it is '{namespaces[0]}/{frame}': --fleet"


def _remedies_of_problems(
    tree: FrameTree, frames: set[str], error: TransformException | None, advice: Advice
) -> Iterator[str]:
    """For problems on the path or, when the frames are not connected, anywhere."""

    def is_near(problem: Problem) -> bool:
        return bool(frames.intersection(problem.frames)) or (
            isinstance(error, ConnectivityException) and problem.kind in ("loop", "silent")
        )

    for problem in tree.problems():
        if is_near(problem) and (remedy := advice.on_problem(problem)):
            yield f"{problem.text}: {remedy}"


_IN_RECORDING: dict[ProblemKind, str] = {
    "loop": "see who sent them: tfbus frames {bag} --at {at}",
    "conflict": "see what each of them sent: tfbus topic echo tf {bag} --from {at}",
    "silent": "see how many of its messages were recorded: tfbus bag info {files}",
    "clock": "pass --sim-time to this tool",
    "unit": "stamp them with node.now_ns(), or tfbus.stamp_ns(SECONDS), and record them again",
}


def explain_recorded(
    frames: RecordedFrames,
    target: str,
    source: str,
    files: Sequence[str],
    *,
    at_moment: bool = False,
) -> Explanation:
    """Explain the latest lookup at the moment of the frames; `files` are the recording's, as on a
    command line. With `at_moment` there is an answer only if there is one at the very moment, as
    `tfbus echo --at` asks for it; of a pause the last before it counts.
    """
    advice = _InRecording(frames, files)
    found = explain(frames.moment(), frames.buffer, target, source, advice=advice)
    if at_moment and frames.pause is None:
        try:
            then = transform_then(frames, target, source)
            found = replace(found, answer=found.answer or then, failure="")
        except TfbusError as error:
            found = replace(found, answer=None, failure=str(error))
    known = frames.buffer.frames()
    hints = [frames.hint(each) for each in (target, source) if each not in known]
    pause = (
        [] if frames.pause is None else [f"{frames.said(frames.pause)}: look before or after it"]
    )
    remedies = dict.fromkeys(filter(None, (*pause, *hints, *found.remedies)))
    return replace(found, remedies=tuple(remedies))


class _InRecording(Advice):
    """The advice for a recording: the place to look at."""

    def __init__(self, frames: RecordedFrames, files: Sequence[str]) -> None:
        self._frames = frames
        self._files = " ".join(files)
        self._bag = " ".join(f"--bag {file}" for file in files)

    def failure(self, error: TransformException) -> str:
        # Another time, or a longer cache, is no advice on a moment of a recording.
        return error.fact if isinstance(error, ExtrapolationException) else str(error)

    def on_gone(self, frame: FrameInfo, stream: StreamInfo) -> str:
        gone_ns = self._frames.gone_ns(stream.name)
        if gone_ns is None:
            return ""
        return (
            f"{who(stream)} was lost at {self._time(gone_ns)}: look just before "
            f"(--at {self._before(gone_ns)}), and into the log of its node"
        )

    def on_stale(self, frame: FrameInfo, stream: StreamInfo) -> str:
        again_ns = self._frames.next_sample_ns(frame.name)
        when = (
            "does not come again" if again_ns is None else f"comes again at {self._time(again_ns)}"
        )
        pause = self._frames.pause_since(frame.name)
        why = (
            "see what its publisher did in that time" if pause is None else self._frames.said(pause)
        )
        return f"{frame.name!r} {when}: {why}"

    def on_no_sample(self, frame: FrameInfo, stream: StreamInfo) -> str:
        heard_ns, gone_ns = (
            self._frames.last_heard_ns(frame.name),
            self._frames.gone_ns(stream.name),
        )
        if heard_ns is None:
            return f"{who(stream)} lists {frame.name!r}, and nothing of it was recorded up to then"
        lost = "" if gone_ns is None else f", and was lost at {self._time(gone_ns)}"
        return (
            f"{who(stream)} began again and sent no {frame.name!r}{lost}: it was last heard at "
            f"{self._time(heard_ns)}, so look just before (--at {self._before(heard_ns)}), and "
            "into the log of its node"
        )

    def on_unknown(self, frame: str) -> str:
        if self._frames.hint(frame):
            return ""  # which says where it is
        return f"see which frames were recorded: tfbus bag info -v {self._files}"

    def on_apart(self, target_root: str, source_root: str) -> str:
        return (
            f"nothing that joins {target_root!r} and {source_root!r} was recorded up to then: see "
            f"which frames came when: tfbus bag info -v {self._files}"
        )

    def on_problem(self, problem: Problem) -> str:
        remedy = _IN_RECORDING.get(problem.kind, "")
        return remedy.format(bag=self._bag, files=self._files, at=self._time(self._frames.at_ns))

    def _before(self, log_ns: int) -> str:
        """A second before a log time, within the recording."""
        return self._time(max(log_ns - S, self._frames.start_ns))

    def _time(self, log_ns: int) -> str:
        return f"+{(log_ns - self._frames.start_ns) / S:.3f}s"
