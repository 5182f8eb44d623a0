"""Checks of how transforms come: their clocks, rates, stamps and sizes."""

from collections import Counter

from tfbus.doctor.examination import Examination
from tfbus.doctor.finding import Finding, found, ok, skipped
from tfbus.doctor.sim_time_checks import of_our_time, of_system_time
from tfbus.frames.gaps import least_gap_s
from tfbus.frames.other_clocks import MOST_SKEW_S, is_ahead, is_another_time, whose_clock
from tfbus.frames.snapshot import in_the_future, who
from tfbus.frames.state import state, why_another_time
from tfbus.listen.info import StreamInfo
from tfbus.monitor.flow import EdgeFlow
from tfbus.wording import counted, duration

# The rate now differs by this factor from that of the history.
_RATE_FACTOR = 1.5
# Jitter above this part of the period is irregular.
_MOST_JITTER = 0.5
_DELAYED = "check the network, and the load of this host (tfbus monitor)"
_SENT_IRREGULARLY = (
    "check the load of its host, and whether its timer or loop waits for other work of its node"
)
# A message longer than Zenoh's batch goes in fragments: one dropped fragment loses all.
_BATCH_BYTES = 65_535


def check_clock_skew(seen: Examination) -> Finding:
    """The clocks of publishers agree with ours."""
    offsets = {
        stream.name: (stream, stream.clock_offset_s)
        for stream in seen.tree.streams.values()
        if stream.alive and stream.clock_offset_s is not None
    }
    skewed = [
        f"the clock of {who(stream)} is {duration(abs(offset))} "
        f"{'ahead of' if offset > 0 else 'behind'} ours"
        for stream, offset in offsets.values()
        if abs(offset) > MOST_SKEW_S
    ]
    if not offsets:
        return skipped("no publisher's clock is known")
    return found(
        "fail",
        skewed,
        "synchronise both hosts to the same server (chrony, or another NTP client)",
        f"{counted(len(offsets), 'clock')} within {duration(MOST_SKEW_S)} of ours",
    )


def check_rates(seen: Examination) -> Finding:
    """Frames come at least as often as they did before."""
    publishers = Counter(flow.child for flow in seen.flows)
    evidence = []
    for flow in _of_near_stamps(seen):
        before_hz = seen.tree.frames[flow.child].rate_hz if flow.child in seen.tree.frames else None
        # The former rate of a frame with several publishers is their sum; see conflicts.
        if not flow.rate_hz or not before_hz or publishers[flow.child] > 1:
            continue
        # More than before is no loss: what was held up comes at once, or it is sent more often.
        if flow.rate_hz * _RATE_FACTOR < before_hz:
            evidence.append(
                f"{flow.child!r} arrives at {flow.rate_hz:.1f} Hz; by its stamps it is sent at "
                f"{before_hz:.1f} Hz"
            )
    return _of_flows(
        seen, "warn", evidence, "check the load of its node and of the network (tfbus monitor)"
    )


def check_jitter(seen: Examination) -> Finding:
    """Frames come regularly."""
    evidence, remedies = [], set()
    # Simulated time goes in steps, and so fast at times that any delay is long.
    for flow in of_system_time(seen):
        if flow.rate_hz and flow.jitter_s and flow.jitter_s * flow.rate_hz > _MOST_JITTER:
            # Where the delays vary as much as the arrivals, the stamps are regular.
            is_delayed = flow.delays_s is not None and flow.delays_s.std_dev > flow.jitter_s / 2.0
            why = (
                "its stamps are regular, its delays are not"
                if is_delayed
                else ("its stamps are as irregular")
            )
            remedies.add(_DELAYED if is_delayed else _SENT_IRREGULARLY)
            evidence.append(
                f"{flow.child!r} arrives at {flow.rate_hz:.1f} Hz, but with a jitter of "
                f"{duration(flow.jitter_s)}: {why}"
            )
    return _of_flows(seen, "warn", evidence, "; ".join(sorted(remedies)))


def check_gaps(seen: Examination) -> Finding:
    """No samples are missing in between."""
    evidence = []
    for flow in _of_near_stamps(seen):
        limit_s = least_gap_s(1.0 / flow.rate_hz if flow.rate_hz else 0.0)
        if flow.longest_gap_s > limit_s:
            evidence.append(
                f"{flow.child!r} paused for {duration(flow.longest_gap_s)}: lookups in that time "
                "interpolate across the gap"
            )
    evidence += [
        f"{counted(stream.missed, 'message')} of stream {stream.name!r} never arrived"
        for stream in seen.tree.streams.values()
        if stream.missed
    ]
    return _of_flows(
        seen,
        "warn",
        evidence,
        "check whether its node stalls or the network drops messages (tfbus monitor)",
    )


def check_order(seen: Examination) -> Finding:
    """Samples come in the order of their stamps."""
    evidence = [
        f"{counted(flow.out_of_order, 'sample')} of {flow.child!r} arrived after a newer one"
        for flow in seen.flows
        if flow.out_of_order
    ]
    return _of_flows(
        seen, "warn", evidence, "publish each frame from one place, with increasing stamps"
    )


def check_stamps(seen: Examination) -> Finding:
    """No stamp is in the future, or zero."""
    evidence = [
        f"{counted(flow.at_zero, 'sample')} of {flow.child!r} arrived with the stamp 0"
        for flow in seen.flows
        if flow.at_zero
    ]
    far = [
        f"samples of {flow.child!r} are {duration(abs(flow.least_delay_s))} "
        f"{'in the future' if flow.least_delay_s < 0 else 'old'}: "
        f"{_why_far(seen, flow)}"
        for flow in of_our_time(seen)
        if flow.least_delay_s is not None
        and is_another_time(flow.least_delay_s)
        and not flow.at_zero
    ]
    evidence += far
    evidence += [
        in_the_future([flow.child], flow.least_delay_s)
        for flow in _of_near_stamps(seen)
        if flow.least_delay_s is not None and _is_ahead(seen, flow)
    ]
    # Of these only what was sent before has come.
    flowing = {flow.child for flow in seen.flows}
    evidence += [
        in_the_future([frame.name], seen.tree.age_s(frame) or 0.0)
        for frame in seen.tree.frames.values()
        if frame.name not in flowing and state(seen.tree, frame) == "ahead"
    ]
    return _of_flows(
        seen,
        "fail",
        evidence,
        "stamp a transform with the time at which it was measured (node.now_ns()); see "
        f"{'clock' if far else 'clock-skew'}",
    )


def check_messages(seen: Examination) -> Finding:
    """Messages fit into one packet of Zenoh."""
    if not seen.largest:
        return skipped("no transform arrived while listening")
    large = [
        f"messages of stream {stream!r} have up to {size / 1e3:.0f} kB"
        for stream, size in seen.largest.items()
        if size > _BATCH_BYTES
    ]
    return found(
        "warn",
        large,
        "send fewer frames at a time, or give each its own key (split=True)",
        "all are below 65 kB",
    )


def check_refused(seen: Examination) -> Finding:
    """No transform was rejected."""
    evidence = [f"{counted(count, 'time')}: {reason}" for reason, count in seen.rejected.items()]
    evidence += [
        f"{counted(stream.rejected, 'message')} of stream {stream.name!r} could not be read"
        for stream in seen.tree.streams.values()
        if stream.rejected
    ]
    if not evidence and not seen.tree.frames:
        return skipped("no frame was found")
    return found(
        "fail", evidence, "fix the publisher; each reason says what is allowed", "none was rejected"
    )


def _is_ahead(seen: Examination, flow: EdgeFlow) -> bool:
    stream = seen.tree.streams.get(flow.stream) or StreamInfo(flow.stream)
    return is_ahead(flow.least_delay_s, stream, is_simulated=seen.settings.sim_time)


def _why_far(seen: Examination, flow: EdgeFlow) -> str:
    """Why the samples of a flow are years away."""
    if seen.settings.sim_time:
        return whose_clock(is_simulated=True)
    return why_another_time(seen.tree, seen.tree.frames.get(flow.child))


def _of_flows(seen: Examination, verdict: str, evidence: list[str], remedy: str) -> Finding:
    if evidence:
        return Finding("fail" if verdict == "fail" else "warn", tuple(evidence), remedy)
    if not seen.flows:
        return skipped("no dynamic transform arrived while listening")
    frames = {flow.child for flow in seen.flows}
    return ok(f"{counted(len(frames), 'dynamic frame')} in {seen.listened_s:.0f} s")


def _of_near_stamps(seen: Examination) -> list[EdgeFlow]:
    """The flows whose stamps can be judged here: those by a clock like ours."""
    return [flow for flow in of_our_time(seen) if not is_another_time(flow.least_delay_s)]
