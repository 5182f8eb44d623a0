"""Checks of the nodes, of the tree of frames, and of its readers."""

from collections import defaultdict
from collections.abc import Sequence

from tfbus.base.wording import counted, duration, listed, natural_order
from tfbus.doctor.examination import (
    Examination,
    Finding,
    PassingProblem,
    RecordedSpan,
    Verdict,
    check,
    found,
    ok,
    skipped,
)
from tfbus.frames.moment import silent_s, state
from tfbus.frames.snapshot import REMEDIES, ProblemKind, who

# A sentence names at most this many namespaces.
_NAMED = 5

_NO_FRAME = "no frame was found"
_WHY_ENDED = "see why its node ended: its log, and its host's"
_WHETHER_ENDED = "see whether its node ended (its log, and its host's), or its link was cut"

# Of a stream that began again and again so many times are named.
_MOST_TIMES = 5


@check("nodes", needs="bus")
def check_nodes(seen: Examination) -> Finding:
    """There are nodes in the namespaces that the doctor looks at, and each answers."""
    if unanswered := [name for name in seen.unanswered if not _is_tool(name)]:
        return Finding(
            "warn",
            tuple(f"{name} is there, and did not answer" for name in unanswered),
            "see whether the process is stopped (Ctrl-Z, a debugger) or too busy",
        )
    count = sum(not _is_tool(node.name) for node in seen.nodes)
    robots = {name.rpartition("/")[0] for name in seen.below if not _is_tool(name)}
    below = sorted(robots, key=natural_order)
    if count or seen.tree.frames:
        also = [f"not checked without --fleet: {_namespaces(below)}"] if below else []
        return ok(f"{counted(count, 'node')} in {seen.scope}", *also)
    if below:
        return Finding(
            "warn",
            (f"no node in {seen.scope}; robots are in {_namespaces(below)}",),
            f"look with --namespace {below[0]}, or at all robots with --fleet",
        )
    where = f" in {seen.scope}"
    if seen.out_of_reach:
        what, _, remedy = seen.out_of_reach.partition(": ")
        return Finding("warn", (f"no node was found{where}; {what}",), remedy)
    return Finding(
        "warn",
        (f"no node was found{where}",),
        "start one, as in: tfbus launch turtle; if others run, they are on another network or "
        "domain: see scouting above, or give --connect ENDPOINT",
    )


def _is_tool(name: str) -> bool:
    return name.rpartition("/")[2].startswith("_")


def _namespaces(names: list[str]) -> str:
    return f"namespace{'s' * (len(names) > 1)} {listed(names, most=_NAMED)}"


@check("robots")
def check_robots(seen: Examination) -> Finding:
    """Each robot of the roster is there, and no other."""
    if not seen.roster:
        return skipped("no roster was given: --fleet --expect ROBOTS")
    away = [each for each in seen.robots if each.is_expected and each.state != "there"]
    lost = [each for each in away if not (seen.is_booting and each.state == "missing")]
    others = [f"{each.name} is not in the roster" for each in seen.robots if not each.is_expected]
    if lost:
        states = [f"{each.name}: {each.state_text(seen.moment.at_ns)}" for each in lost]
        return Finding(
            "fail",
            (*states, *others),
            "start it, or check its link and the namespace of its nodes (tfbus fleet --watch shows "
            "when it comes); take a robot that will not come from the roster",
        )
    return found(
        "warn",
        others,
        "add it to the roster (--expect), or correct the namespace of its nodes",
        f"{len(seen.roster) - len(away):,} of {counted(len(seen.roster), 'robot')} there",
    )


@check("node-names")
def check_node_names(seen: Examination) -> Finding:
    """No two nodes have the same name."""
    places = defaultdict(list)
    for node in seen.nodes:
        places[node.name].append(f"{node.host}, pid {node.pid}")
    doubled = [_alike(name, where) for name, where in places.items() if len(where) > 1]
    if (span := seen.span) is not None:
        doubled = [f"{span.when(each)}, {_alike(each.node, each.places)}" for each in span.twins]
    count = sum(not _is_tool(node.name) for node in seen.nodes)
    if not doubled and not count:
        return skipped("no node was found")
    return found(
        "fail",
        doubled,
        "give each its own name (--name) or namespace (--namespace)",
        counted(count, "node"),
    )


def _alike(name: str, places: Sequence[str]) -> str:
    return f"{len(places)} nodes are called {name}: on {'; on '.join(places)}"


@check("callbacks", needs="bus")
def check_callbacks(seen: Examination) -> Finding:
    """No callback raises exceptions, or holds up timers and topics of its node."""
    nodes = [node for node in seen.nodes if not _is_tool(node.name)]
    if not nodes:
        return skipped("no node was found")
    failed = [
        f"{node.name}: {failure}"
        for node in nodes
        for failure in node.failures
        if seen.is_recent(node, failure.last_ns)
    ]
    held_up = [f"{node.name}: {delay}" for node in nodes for delay in node.delays]
    remedies = [
        "see the traceback in the log of the node" if failed else "",
        "let a callback that waits be an async def, or give it a callback group of its own"
        if held_up
        else "",
    ]
    remedy = "; ".join(filter(None, remedies))
    return found("warn", [*failed, *held_up], remedy, counted(len(nodes), "node"))


@check("conflicts")
def check_conflicts(seen: Examination) -> Finding:
    """Each frame has one publisher."""
    return _of_tree(seen, "conflict", "fail")


@check("loops")
def check_loops(seen: Examination) -> Finding:
    """No edges make a loop."""
    return _of_tree(seen, "loop", "fail")


@check("orphans")
def check_orphans(seen: Examination) -> Finding:
    """No frame is alone."""
    return _of_tree(seen, "orphan", "warn")


@check("disconnected")
def check_disconnected(seen: Examination) -> Finding:
    """All frames are in one tree."""
    apart = [each.frames[0] for each in seen.moment.problems if each.kind == "disconnected"]
    is_listed = bool(apart) and all(name in seen.tree.claims for name in apart)
    return _of_tree(
        seen,
        "disconnected",
        "warn",
        # Its publisher knows the parent, and sends nothing.
        "see silent: the transform between the trees is listed, and has not come"
        if is_listed
        else "",
    )


@check("gone")
def check_gone(seen: Examination) -> Finding:
    """The publisher of each frame runs."""
    span = seen.span
    if span is None:
        return _of_tree(seen, "gone", "warn")
    gone = filter(_is_gone, span.passing)
    remedies = dict.fromkeys(_on_gone(seen, span, each) for each in gone)
    if _WHETHER_ENDED in remedies:
        remedies.pop(_WHY_ENDED, None)  # the same two logs answer both
    return _of_tree(seen, "gone", "warn", "; ".join(remedies))


def _is_gone(passing: PassingProblem) -> bool:
    return passing.problem.kind == "gone"


def _on_gone(seen: Examination, span: RecordedSpan, gone: PassingProblem) -> str:
    """The remedy, by the epochs: the messages of a node that was not restarted go on in the same
    epoch.
    """
    if gone.until_ns is None:
        return _WHETHER_ENDED
    frames = [seen.tree.frames.get(name) for name in gone.problem.frames]
    streams = {frame.authority for frame in frames if frame is not None}
    begun = [log_ns for name in streams for log_ns in span.restarts.get(name, ())]
    # The first message comes some time after the node.
    again = (each.from_ns or 0 for each in span.passing if _is_gone(each) and each != gone)
    next_ns = min((at_ns for at_ns in again if at_ns > gone.until_ns), default=None)
    if any(
        (gone.from_ns or 0) <= at_ns and (next_ns is None or at_ns < next_ns) for at_ns in begun
    ):
        return _WHY_ENDED
    return "check the link to its host: its node came back without a restart"


@check("restarts", needs="recording")
def check_restarts(seen: Examination) -> Finding:
    """No publisher was restarted."""
    evidence = []
    span = seen.span
    for name, times in sorted(span.restarts.items()) if span else ():
        stream = seen.tree.streams.get(name)
        publisher = f"stream {name!r}" if stream is None else who(stream)
        when = ", ".join(map(span.time, times[:_MOST_TIMES])) if span else ""
        evidence.append(f"{publisher} began again at {when}: restarted, or its clock went back")
    return found("warn", evidence, _WHY_ENDED, counted(len(seen.tree.streams), "stream"))


@check("stale")
def check_stale(seen: Examination) -> Finding:
    """Samples of each dynamic frame still come."""
    tree = seen.tree
    if not tree.frames:
        return skipped(_NO_FRAME)
    sentences = [
        f"no sample of {frame.name!r} for {duration(silent_s(tree, frame))}: "
        f"{who(tree.publisher(frame))}"
        for frame in tree.frames.values()
        if state(tree, frame) == "stale"
    ]
    return found(
        "warn",
        sentences,
        "see whether its node still sends (tfbus monitor), and what it waits for",
        counted(len(tree.frames), "frame"),
    )


@check("silent")
def check_silent(seen: Examination) -> Finding:
    """Each announced frame is sent."""
    return _of_tree(seen, "silent", "warn")


@check("static-dynamic")
def check_static_dynamic(seen: Examination) -> Finding:
    """No frame is both static and dynamic."""
    kinds = defaultdict(list)
    for stream in seen.tree.streams.values():
        for _, child, static in stream.frames:
            if stream.alive:
                kinds[child].append((static, stream))
    mixed = [
        f"{child!r} is "
        + " and ".join(
            f"{'static' if static else 'dynamic'} by {who(stream)}" for static, stream in claims
        )
        for child, claims in kinds.items()
        if len({static for static, _ in claims}) > 1
    ]
    if not kinds:
        return skipped(_NO_FRAME)
    return found("fail", mixed, "publish it either as static or as dynamic", "none is both")


def _of_tree(seen: Examination, kind: ProblemKind, verdict: Verdict, remedy: str = "") -> Finding:
    """The finding of problems of a kind; their own remedies, unless another is given."""
    sentences = seen.problems(kind)
    own = dict.fromkeys(each.remedy for each in seen.moment.problems if each.kind == kind)
    if not sentences and not seen.tree.frames:
        return skipped(_NO_FRAME)
    frames = counted(len(seen.tree.frames), "frame")
    return found(verdict, sentences, remedy or "; ".join(own) or REMEDIES[kind], frames)


# A few unread streams are normal at the start; many are forgotten ones.
_FEW_UNREAD = 10


@check("unread", needs="bus")
def check_unread(seen: Examination) -> Finding:
    """At most ten streams are unread."""
    if not any(node.streams for node in seen.nodes):
        return skipped("no node publishes a frame")
    unread = [
        f"no node reads the dynamic frames of stream {stream!r} of {node.name}"
        for node in seen.nodes
        for stream in node.unread
    ]
    if len(unread) <= _FEW_UNREAD:
        return ok(*(unread or ["each stream is read"]))
    return Finding(
        "warn",
        tuple(unread),
        "stop their nodes, or start the nodes that should read them",
    )


@check("buffers", needs="bus")
def check_buffers(seen: Examination) -> Finding:
    """Buffers are long enough for their lookups, which ask for times that can be."""
    buffers = [(node, buffer) for node in seen.nodes for buffer in node.buffers]
    if not buffers:
        return skipped("no node has a buffer")
    short = [
        f"{node.name} keeps {duration(buffer.cache_time_s)}, but "
        f"{counted(buffer.too_old, 'lookup')} asked for older data, by up to "
        f"{duration(buffer.missed_by_s)}"
        for node, buffer in buffers
        if buffer.too_old
    ]
    mistaken = [
        f"{node.name}: {counted(buffer.mistaken, 'lookup')} asked for a time that has no answer: "
        f"{buffer.mistake}"
        for node, buffer in buffers
        if buffer.mistaken
    ]
    remedies = [
        "look up the stamps of messages, or node.now_ns()" if mistaken else "",
        "give it a longer cache (Buffer(cache_time_s=...)), or look up sooner" if short else "",
    ]
    remedy = "; ".join(filter(None, remedies))
    return found("warn", [*mistaken, *short], remedy, counted(len(buffers), "buffer"))


@check("filters", needs="bus")
def check_filters(seen: Examination) -> Finding:
    """Messages that wait for their transform get it."""
    filters = [(node, each) for node in seen.nodes for each in node.filters]
    if not filters:
        return skipped("no subscription waits for transforms")
    dropped = [
        (node, each)
        for node, each in filters
        if each.dropped and seen.is_recent(node, each.last_ns)
    ]
    before = sum(each.dropped for _, each in filters) if not dropped else 0
    fine = counted(len(filters), "subscription")
    lookups = sorted(
        f"tfbus why {each.frame} {source}" for _, each in dropped for source in each.sources
    )
    return found(
        "warn",
        [f"{node.name}: {each}" for node, each in dropped],
        f"see why: {listed(lookups, most=3)}" if lookups else "see the log of the node",
        f"{fine}, of which none dropped a message in the last minute" if before else fine,
    )


@check("dropped", needs="bus")
def check_dropped(seen: Examination) -> Finding:
    """Listeners drop no messages."""
    buffers = [(node, buffer) for node in seen.nodes for buffer in node.buffers]
    if not buffers:
        return skipped("no node has a buffer")
    dropped = [
        f"{node.name} dropped {counted(buffer.dropped, 'message')}: transforms come on more keys "
        "than it accepts"
        for node, buffer in buffers
        if buffer.dropped
    ]
    return found(
        "fail",
        dropped,
        "do not split streams of many frames, or read only what is needed (reads='needed')",
        "no message was dropped",
    )
