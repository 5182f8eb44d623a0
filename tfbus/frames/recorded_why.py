"""Why a lookup fails, or would fail, at a moment of a recording, and where in it to look."""

from collections.abc import Sequence
from dataclasses import replace

from tfbus.buffer.explain import without_advice
from tfbus.buffer.info import FrameInfo
from tfbus.errors import TfbusError
from tfbus.frames.recorded import RecordedFrames, S
from tfbus.frames.recorded_poses import transform_then
from tfbus.frames.snapshot import Problem, ProblemKind, who
from tfbus.frames.why import Advice, Explanation, explain
from tfbus.listen.info import StreamInfo

_REMEDIES: dict[ProblemKind, str] = {
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
    """Explain the latest lookup at the moment of the frames; `files` are those of the recording, as
    on a command line. With `at_moment` there is an answer only where there is one at the very
    moment, as `tfbus echo --at` asks for it; of a pause the last before it counts.
    """
    advice = _InRecording(frames, files)
    found = explain(frames.tree(), frames.buffer, target, source, advice=advice)
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
    return replace(found, failure=without_advice(found.failure), remedies=tuple(remedies))


class _InRecording(Advice):
    """What to look at in the recording."""

    def __init__(self, frames: RecordedFrames, files: Sequence[str]) -> None:
        self._frames = frames
        self._files = " ".join(files)
        self._bag = " ".join(f"--bag {file}" for file in files)

    def on_gone(self, frame: FrameInfo, stream: StreamInfo) -> str:
        gone_ns = self._frames.gone_ns(stream.name)
        if gone_ns is None:
            return ""
        before = self._time(max(gone_ns - S, self._frames.start_ns))
        return (
            f"{who(stream)} was lost at {self._time(gone_ns)}: look just before (--at {before}), "
            "and into the log of its node"
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
        return f"{who(stream)} lists {frame.name!r}, and nothing of it was recorded up to then"

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
        remedy = _REMEDIES.get(problem.kind, "")
        return remedy.format(bag=self._bag, files=self._files, at=self._time(self._frames.at_ns))

    def _time(self, log_ns: int) -> str:
        return f"+{(log_ns - self._frames.start_ns) / S:.3f}s"
