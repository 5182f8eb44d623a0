"""Checks of a recording: what was wrong on its bus, when, and whether the recording is whole."""

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

from tfbus.doctor import flow_checks, reader_checks, tree_checks
from tfbus.doctor.finding import Finding, Verdict, first_of, found, ok, skipped
from tfbus.doctor.recorded import PassingProblem, RecordedExamination
from tfbus.doctor.sim_time_checks import of_our_time
from tfbus.frames.gaps import gaps_in
from tfbus.frames.other_clocks import is_another_time
from tfbus.frames.snapshot import ProblemKind, who
from tfbus.monitor.flow import EdgeFlow
from tfbus.monitor.recorded import EdgeSamples
from tfbus.wording import counted, duration, listed

if TYPE_CHECKING:
    import numpy as np
else:
    from tfbus.core import lazy_numpy as np

RecordedCheck = Callable[[RecordedExamination], Finding]

_WHY_ENDED = "see why its node ended: its log, and its host's"

# The rate in a part of the span differs by this factor from that of the whole.
_RATE_FACTOR = 1.5
_PARTS = 10
# Of a part with fewer samples than this there is no rate.
_FEW = 5

# Delays that change by more than this from one second to the next, and stay so, are a clock's jump.
_JUMP_S = 0.1
_BIN_NS = 1_000_000_000


def check_complete(seen: RecordedExamination) -> Finding:
    """The recording is whole: not cut short, and nothing was dropped."""
    evidence = []
    if not seen.is_complete:
        evidence.append("it is cut short: the recorder was killed, or its disk was full")
    if seen.damage:
        evidence.append(f"it is damaged: {listed(seen.damage)} cannot be read")
    if seen.lost:
        evidence.append(
            f"the recorder dropped {counted(seen.lost, 'message')}: its disk or host was too slow"
        )
    pauses = f", paused {counted(seen.paused, 'time')}" if seen.paused else ""
    return found(
        "warn",
        evidence,
        "tfbus bag recover writes a whole file of what is there"
        if not seen.is_complete or seen.damage
        else "record less (--exclude), or onto a faster disk",
        f"{duration(seen.listened_s)}, whole{pauses}",
    )


def check_conflicts(seen: RecordedExamination) -> Finding:
    """Each frame has one publisher."""
    return _of_passing(seen, "conflict", "fail", "stop one of the two, or rename one of the frames")


def check_loops(seen: RecordedExamination) -> Finding:
    """No edges make a loop."""
    remedy = "swap parent and child of the edge that points the wrong way"
    return _of_passing(seen, "loop", "fail", remedy)


def check_gone(seen: RecordedExamination) -> Finding:
    """No publisher left the bus."""
    remedies = dict.fromkeys(_on_gone(seen, each) for each in seen.passing if _is_gone(each))
    return _of_passing(seen, "gone", "warn", "; ".join(remedies))


def _is_gone(passing: PassingProblem) -> bool:
    return passing.problem.kind == "gone"


def _on_gone(seen: RecordedExamination, gone: PassingProblem) -> str:
    """The remedy, by what is known: the messages of a node that was not restarted come on in the
    same epoch.
    """
    if gone.until_ns is None:
        return "see whether its node ended (its log, and its host's), or its link was cut"
    frames = [seen.tree.frames.get(name) for name in gone.problem.frames]
    streams = {frame.authority for frame in frames if frame is not None}
    begun = [log_ns for name in streams for log_ns in seen.restarts.get(name, ())]
    # The first message comes some time after the node.
    again = (each.from_ns for each in seen.passing if _is_gone(each) and each != gone)
    next_ns = min((at_ns for at_ns in again if at_ns > gone.until_ns), default=None)
    if any(gone.from_ns <= at_ns and (next_ns is None or at_ns < next_ns) for at_ns in begun):
        return _WHY_ENDED
    return "check the link to its host: its node came back without a restart"


def check_restarts(seen: RecordedExamination) -> Finding:
    """No publisher was restarted."""
    evidence = []
    for name, times in sorted(seen.restarts.items()):
        stream = seen.tree.streams.get(name)
        publisher = f"stream {name!r}" if stream is None else who(stream)
        when = ", ".join(map(seen.time, first_times(times)))
        evidence.append(f"{publisher} began again at {when}: restarted, or its clock went back")
    return found(
        "warn",
        first_of(evidence),
        _WHY_ENDED,
        counted(len(seen.tree.streams), "stream"),
    )


def first_times(times: list[int]) -> list[int]:
    """The first five."""
    return times[:5]


def check_rates(seen: RecordedExamination) -> Finding:
    """Frames come as often in all parts of the span."""
    evidence = []
    for (_, _, child), samples in sorted(seen.samples.items()):
        evidence += list(_changed_rates(seen, child, samples))
    return _of_samples(
        seen, evidence, "check the load of its node and of the network (tfbus monitor --bag)"
    )


def _changed_rates(seen: RecordedExamination, child: str, samples: EdgeSamples) -> Iterator[str]:
    log_ns = samples.log_ns
    parts = np.array_split(log_ns, _PARTS)
    rates = [
        (int(part[0]), (len(part) - 1) * 1e9 / float(part[-1] - part[0]))
        for part in parts
        if len(part) >= _FEW and part[-1] > part[0] and not gaps_in(np.diff(part)).any()
    ]
    if not rates:
        return
    usual = float(np.median([hz for _, hz in rates]))
    odd = [(at_ns, hz) for at_ns, hz in rates if not 1 / _RATE_FACTOR < hz / usual < _RATE_FACTOR]
    if odd:
        at_ns, hz = odd[0]
        yield f"{child!r} comes at {usual:.1f} Hz, but from {seen.time(at_ns)} on at {hz:.1f} Hz"


def check_gaps(seen: RecordedExamination) -> Finding:
    """No samples are missing in between."""
    evidence = [_of_gap(seen, flow, flow.gap_from_ns) for flow in seen.flows if flow.gap_from_ns]
    evidence += [
        f"{counted(stream.missed, 'message')} of stream {stream.name!r} never arrived"
        for stream in seen.tree.streams.values()
        if stream.missed
    ]
    return _of_samples(
        seen, evidence, "check whether its node stalled, or the network dropped messages"
    )


def _of_gap(seen: RecordedExamination, flow: EdgeFlow, from_ns: int) -> str:
    until_ns = from_ns + round(flow.longest_gap_s * 1e9)
    is_restart = any(from_ns < each <= until_ns for each in seen.restarts.get(flow.stream, ()))
    effect = "its stream restarted" if is_restart else "lookups then interpolate across the gap"
    if flow.gaps == 1:
        return (
            f"{flow.child!r} paused from {seen.time(from_ns)} to {seen.time(until_ns)}, for "
            f"{duration(flow.longest_gap_s)}: {effect}"
        )
    return (
        f"{flow.child!r} paused {flow.gaps} times, the longest from {seen.time(from_ns)} to "
        f"{seen.time(until_ns)}, for {duration(flow.longest_gap_s)}: {effect}"
    )


def check_clock_jumps(seen: RecordedExamination) -> Finding:
    """The clocks of publishers and recorder went on evenly."""
    streams = {flow.stream for flow in of_our_time(seen) if not is_another_time(flow.least_delay_s)}
    evidence: dict[str, str] = {}
    for (stream, _, _), samples in sorted(seen.samples.items()):
        if stream in streams and stream not in evidence:
            for at_ns, jump_s in _jumps(samples):
                side = "back" if jump_s > 0 else "forward"
                evidence[stream] = (
                    f"stamps of stream {stream!r} jump {side} by {duration(abs(jump_s))} at "
                    f"{seen.time(at_ns)}, against the clock of the recorder"
                )
                break
    return _of_samples(
        seen, list(evidence.values()), "let NTP slew the clocks (chrony), not step them"
    )


def _jumps(samples: EdgeSamples) -> Iterator[tuple[int, float]]:
    """When the delays of an edge jumped and stayed so, and by how much, in s."""
    bins = (samples.log_ns - samples.log_ns[0]) // _BIN_NS
    _, first = np.unique(bins, return_index=True)
    least = np.minimum.reduceat(samples.now_ns - samples.stamps_ns, first) / 1e9
    before, after, later = least[:-2], least[1:-1], least[2:]
    jumped = (np.abs(after - before) > _JUMP_S) & (np.abs(later - before) > _JUMP_S)
    jumped &= np.abs(later - after) < _JUMP_S
    for at in np.nonzero(jumped)[0].tolist():
        yield int(samples.log_ns[first[at + 1]]), float(after[at] - before[at])


def _of_passing(
    seen: RecordedExamination, kind: ProblemKind, verdict: Verdict, remedy: str
) -> Finding:
    sentences = []
    for each in seen.passing:
        if each.problem.kind == kind:
            until = "" if each.until_ns is None else f" to {seen.time(each.until_ns)}"
            on = " on" if each.until_ns is None else ""
            sentences.append(f"from {seen.time(each.from_ns)}{until}{on}, {each.problem.text}")
    return found(verdict, first_of(sentences), remedy, counted(len(seen.tree.frames), "frame"))


def _of_samples(seen: RecordedExamination, evidence: list[str], remedy: str) -> Finding:
    if not seen.flows:
        return skipped("there is no dynamic transform in the span")
    if evidence:
        return Finding("warn", tuple(first_of(evidence)), remedy)
    frames = {flow.child for flow in seen.flows}
    return ok(f"{counted(len(frames), 'dynamic frame')} in {duration(seen.listened_s)}")


RECORDED_CHECKS: dict[str, RecordedCheck] = {
    "complete": check_complete,
    "node-names": tree_checks.check_node_names,
    "conflicts": check_conflicts,
    "loops": check_loops,
    "orphans": tree_checks.check_orphans,
    "disconnected": tree_checks.check_disconnected,
    "static-dynamic": tree_checks.check_static_dynamic,
    "gone": check_gone,
    "restarts": check_restarts,
    "stale": tree_checks.check_stale,
    "silent": tree_checks.check_silent,
    "clock-jumps": check_clock_jumps,
    "rates": check_rates,
    "jitter": flow_checks.check_jitter,
    "gaps": check_gaps,
    "order": flow_checks.check_order,
    "stamps": flow_checks.check_stamps,
    "refused": flow_checks.check_refused,
    "unread": reader_checks.check_unread,
    "buffers": reader_checks.check_buffers,
    "dropped": reader_checks.check_dropped,
}
