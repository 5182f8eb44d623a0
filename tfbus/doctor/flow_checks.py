"""Checks of how transforms come: their clocks, rates, stamps and sizes."""

from collections import Counter
from collections.abc import Iterator

from tfbus.base import lazy_numpy as np
from tfbus.base.wording import counted, duration, listed
from tfbus.doctor.examination import (
    Examination,
    Finding,
    RecordedSpan,
    Verdict,
    check,
    found,
    ok,
    skipped,
)
from tfbus.frames.clocks import (
    MOST_SKEW_S,
    is_ahead,
    is_another_time,
    is_late,
    simulated_time,
    whose_clock,
)
from tfbus.frames.moment import state, why_another_time
from tfbus.frames.report import EdgeFlow, EdgeSamples
from tfbus.frames.snapshot import come_late, in_the_future, who, why_unreadable
from tfbus.frames.track import gaps_in, least_gap_s
from tfbus.streams.info import StreamInfo


@check("clock")
def check_clock(seen: Examination) -> Finding:
    """The doctor uses the same time as the publishers."""
    time = simulated_time(seen.nodes)
    if not time.clocks:
        return ok("no simulated time is published")
    if seen.settings.sim_time or not time.followers:
        return ok(time.published, time.followed)
    return Finding(
        "warn",
        (f"{time.published}; {time.followed}, and this doctor does not",),
        "give --sim-time to this tool, and to all nodes that look up these frames",
    )


def of_our_time(seen: Examination) -> list[EdgeFlow]:
    """The flows whose stamps are by the doctor's own clock, as far as their nodes say."""
    return list(seen.flows) if seen.settings.sim_time else of_system_time(seen)


def of_system_time(seen: Examination) -> list[EdgeFlow]:
    """The flows of publishers without simulated time, as far as their nodes say."""
    following = simulated_time(seen.nodes).followers
    streams = seen.tree.streams
    return [
        flow
        for flow in seen.flows
        if flow.stream not in streams or streams[flow.stream].node not in following
    ]


# The rate now differs by this factor from that of the history.
_RATE_FACTOR = 1.5
# The rate of one of so many parts of a span is compared with that of the whole, unless a part has
# fewer samples than this.
_PARTS, _FEW = 10, 5
# Delays that change by more than this from one second to the next, and stay so, are a clock's jump.
_JUMP_S = 0.1
_BIN_NS = 1_000_000_000
# Jitter above this part of the period is irregular.
_MOST_JITTER = 0.5
_DELAYED = "check the network, and the load of this host (tfbus monitor)"
_SENT_IRREGULARLY = (
    "check the load of its host, and whether its timer or loop waits for other work of its node"
)
# A message longer than Zenoh's batch goes in fragments: one dropped fragment loses all.
_BATCH_BYTES = 65_535


@check("complete", needs="recording")
def check_complete(seen: Examination) -> Finding:
    """The recording is whole: not cut short, and nothing was dropped."""
    span = seen.span
    if span is None:
        return skipped("it needs a recording")
    evidence = []
    is_cut = not (span.is_complete or span.is_growing)
    if is_cut:
        evidence.append("it is cut short: the recorder was killed, or its disk was full")
    if span.damage:
        evidence.append(f"it is damaged: {listed(span.damage)} cannot be read")
    if span.lost:
        evidence.append(
            f"the recorder dropped {counted(span.lost, 'message')}: its disk or host was too slow"
        )
    pauses = f", paused {counted(span.paused, 'time')}" if span.paused else ""
    return found(
        "warn",
        evidence,
        "tfbus bag recover writes a whole file of what is there"
        if is_cut or span.damage
        else "record less (--exclude), or onto a faster disk",
        f"{duration(seen.listened_s)}, {'being written' if span.is_growing else 'whole'}{pauses}",
    )


@check("clock-skew", needs="bus")
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


@check("rates")
def check_rates(seen: Examination) -> Finding:
    """Frames come as often as they are sent, and at all times."""
    span = seen.span
    if span is None:
        evidence = _held_up(seen)
    else:
        samples = sorted(span.samples.items())
        evidence = [
            each for (_, _, child), of in samples for each in _changed_rates(span, child, of)
        ]
    return _of_flows(
        seen, "warn", evidence, "check the load of its node and of the network (tfbus monitor)"
    )


def _held_up(seen: Examination) -> list[str]:
    """The frames that come less often now than by the stamps of their publishers' kept samples."""
    publishers = Counter(flow.child for flow in seen.flows)
    evidence = []
    for flow in _of_near_stamps(seen):
        before_hz = seen.tree.frames[flow.child].rate_hz if flow.child in seen.tree.frames else None
        # The former rate of a frame with several publishers is their sum; see conflicts.
        if not flow.rate_hz or not before_hz or publishers[flow.child] > 1:
            continue
        # More than before is no loss: held up samples come at once, or it is sent more often.
        if flow.rate_hz * _RATE_FACTOR < before_hz:
            evidence.append(
                f"{flow.child!r} arrives at {flow.rate_hz:.1f} Hz; by its stamps it is sent at "
                f"{before_hz:.1f} Hz"
            )
    return evidence


def _changed_rates(span: RecordedSpan, child: str, samples: EdgeSamples) -> Iterator[str]:
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
        yield f"{child!r} comes at {usual:.1f} Hz, but from {span.time(at_ns)} on at {hz:.1f} Hz"


@check("jitter")
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


@check("gaps")
def check_gaps(seen: Examination) -> Finding:
    """No samples are missing in between."""
    if seen.span is None:
        evidence = list(_pauses(seen))
    else:
        evidence = [
            _of_gap(seen.span, flow, flow.gap_from_ns) for flow in seen.flows if flow.gap_from_ns
        ]
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


def _pauses(seen: Examination) -> Iterator[str]:
    """The pauses by the stamps: kept samples have no arrivals."""
    for flow in _of_near_stamps(seen):
        if flow.longest_gap_s > least_gap_s(flow.period_s or 0.0):
            yield (
                f"{flow.child!r} paused for {duration(flow.longest_gap_s)}: lookups in that time "
                "interpolate across the gap"
            )


def _of_gap(span: RecordedSpan, flow: EdgeFlow, from_ns: int) -> str:
    until_ns = from_ns + round(flow.longest_gap_s * 1e9)
    is_restart = any(from_ns < each <= until_ns for each in span.restarts.get(flow.stream, ()))
    effect = "its stream restarted" if is_restart else "lookups then interpolate across the gap"
    if flow.gaps == 1:
        return (
            f"{flow.child!r} paused from {span.time(from_ns)} to {span.time(until_ns)}, for "
            f"{duration(flow.longest_gap_s)}: {effect}"
        )
    return (
        f"{flow.child!r} paused {flow.gaps} times, the longest from {span.time(from_ns)} to "
        f"{span.time(until_ns)}, for {duration(flow.longest_gap_s)}: {effect}"
    )


@check("clock-jumps", needs="recording")
def check_clock_jumps(seen: Examination) -> Finding:
    """The clocks of publishers and recorder went on evenly."""
    span = seen.span
    if span is None:
        return skipped("it needs a recording")
    streams = {flow.stream for flow in of_our_time(seen) if not is_another_time(flow.least_delay_s)}
    evidence: dict[str, str] = {}
    for (stream, _, _), samples in sorted(span.samples.items()):
        if stream in streams and stream not in evidence:
            for at_ns, jump_s in _jumps(samples):
                side = "back" if jump_s > 0 else "forward"
                evidence[stream] = (
                    f"stamps of stream {stream!r} jump {side} by {duration(abs(jump_s))} at "
                    f"{span.time(at_ns)}, against the clock of the recorder"
                )
                break
    return _of_flows(
        seen, "warn", list(evidence.values()), "let NTP slew the clocks (chrony), not step them"
    )


def _jumps(samples: EdgeSamples) -> Iterator[tuple[int, float]]:
    """When the delays of an edge jumped and stayed so, and by how much, in s."""
    bins = (samples.log_ns - samples.log_ns[0]) // _BIN_NS
    _, first = np.unique(bins, return_index=True)
    delays = (samples.now_ns - samples.stamps_ns) / 1e9
    least = np.minimum.reduceat(delays, first)
    before, after, later = least[:-2], least[1:-1], least[2:]
    jumped = (np.abs(after - before) > _JUMP_S) & (np.abs(later - before) > _JUMP_S)
    jumped &= np.abs(later - after) < _JUMP_S
    for at in np.nonzero(jumped)[0].tolist():
        # A jump is in the middle of a bin, or of the one before: right after its last former delay.
        middle = (before[at] + after[at]) / 2
        is_former = (delays[first[at] : first[at + 2]] < middle) == (before[at] < middle)
        row = int(first[at] + np.nonzero(is_former)[0][-1] + 1)
        yield int(samples.log_ns[row]), float(after[at] - before[at])


@check("order")
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


@check("stamps")
def check_stamps(seen: Examination) -> Finding:
    """No stamp is in the future, zero, or long past when it comes."""
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
    # Of these only earlier samples have come.
    flowing = {flow.child for flow in seen.flows}
    evidence += [
        in_the_future([frame.name], seen.tree.age_s(frame) or 0.0)
        for frame in seen.tree.frames.values()
        if frame.name not in flowing and state(seen.tree, frame) == "ahead"
    ]
    return _of_flows(
        seen,
        "fail" if evidence else "warn",
        [*evidence, *_late(seen)],
        "stamp a transform with the time at which it was measured (node.now_ns()); see "
        f"{'clock' if far else 'clock-skew'}",
    )


@check("messages", needs="bus")
def check_messages(seen: Examination) -> Finding:
    """Messages of transforms fit into one packet of Zenoh."""
    if not seen.loads:
        return skipped("no transform arrived while listening")
    large = [
        f"messages of stream {stream!r} have up to {load.largest_bytes / 1e3:.0f} kB"
        for stream, load in seen.loads.items()
        if load.largest_bytes and load.largest_bytes > _BATCH_BYTES
    ]
    return found(
        "warn",
        large,
        "send fewer frames at a time, or give each its own key (split=True)",
        "all of transforms are below 65 kB",
    )


@check("refused")
def check_refused(seen: Examination) -> Finding:
    """No transform was rejected."""
    evidence = [
        f"{counted(count, 'time')}: {reason}" for reason, count in seen.moment.rejected.items()
    ]
    evidence += [
        why_unreadable(stream)
        for stream in seen.tree.streams.values()
        if stream.rejected or (stream.unreadable and not stream.node)
    ]
    if not evidence and not seen.tree.frames:
        return skipped("no frame was found")
    return found(
        "fail",
        evidence,
        "fix the publisher, or update it; each reason says what is allowed",
        "none was rejected",
    )


def _is_ahead(seen: Examination, flow: EdgeFlow) -> bool:
    stream = seen.tree.streams.get(flow.stream) or StreamInfo(flow.stream)
    return is_ahead(flow.least_delay_s, stream, is_simulated=seen.settings.sim_time)


def _late(seen: Examination) -> Iterator[str]:
    is_simulated = seen.settings.sim_time
    # Who plays a recording with its old stamps publishes its clock.
    if is_simulated or not simulated_time(seen.nodes).clocks:
        for flow in _of_near_stamps(seen):
            delay_s = flow.least_delay_s
            if delay_s and is_late(delay_s, flow.rate_hz, is_simulated=is_simulated):
                yield come_late([flow.child], delay_s)


def _why_far(seen: Examination, flow: EdgeFlow) -> str:
    """Why the samples of a flow are years away."""
    if seen.settings.sim_time:
        return whose_clock(is_simulated=True)
    return why_another_time(seen.tree, seen.tree.frames.get(flow.child))


def _of_flows(seen: Examination, verdict: Verdict, evidence: list[str], remedy: str) -> Finding:
    if not evidence and not seen.flows:
        return skipped(f"no dynamic transform came in {duration(seen.listened_s)}")
    frames = counted(len({flow.child for flow in seen.flows}), "dynamic frame")
    return found(verdict, evidence, remedy, f"{frames} in {duration(seen.listened_s)}")


def _of_near_stamps(seen: Examination) -> list[EdgeFlow]:
    """The flows whose stamps can be judged here: by a clock like ours."""
    return [flow for flow in of_our_time(seen) if not is_another_time(flow.least_delay_s)]
