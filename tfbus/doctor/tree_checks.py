"""Checks of the nodes, and of the tree of frames."""

from collections import defaultdict

from tfbus.doctor.examination import Examination
from tfbus.doctor.finding import Finding, Verdict, first_of, found, ok, skipped
from tfbus.frames.snapshot import ProblemKind, who
from tfbus.frames.state import silent_s, state
from tfbus.wording import counted, duration, listed

# A sentence names at most this many namespaces.
_NAMED = 5

_NO_FRAME = "no frame was found"


def check_nodes(seen: Examination) -> Finding:
    """There are nodes in the namespace that the doctor looks at."""
    namespace = seen.settings.namespace
    inside = [node.name.strip("/") for node in seen.nodes if not _is_tool(node.name)]
    inside = [name.removeprefix(f"{namespace}/") for name in inside if _is_below(name, namespace)]
    robots = sorted({name.rpartition("/")[0] for name in inside} - {""})
    here = sum("/" not in name for name in inside)
    if here or seen.tree.frames:
        also = [f"more are in {_namespaces(robots)}"] if robots else []
        return ok(counted(here, "node"), *also)
    if robots:
        return Finding(
            "warn",
            (f"no nodes here; robots are in {_namespaces(robots)}",),
            f"look with --namespace {robots[0]}, or at all robots with --fleet",
        )
    where = f" in namespace {namespace!r}" if namespace else ""
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


def _is_below(name: str, namespace: str) -> bool:
    return not namespace or name.startswith(f"{namespace}/")


def _namespaces(names: list[str]) -> str:
    return f"namespace{'s' * (len(names) > 1)} {listed(names, most=_NAMED)}"


def check_node_names(seen: Examination) -> Finding:
    """No two nodes have the same name."""
    places = defaultdict(list)
    for node in seen.nodes:
        places[node.name].append(f"{node.host}, pid {node.pid}")
    doubled = [
        f"{len(where)} nodes are called {name}: on {'; on '.join(where)}"
        for name, where in places.items()
        if len(where) > 1
    ]
    count = sum(not _is_tool(node.name) for node in seen.nodes)
    if not doubled and not count:
        return skipped("no node was found")
    return found(
        "fail",
        doubled,
        "give each its own name (--name) or namespace (--namespace)",
        counted(count, "node"),
    )


def check_callbacks(seen: Examination) -> Finding:
    """No callback holds up timers and topics of its node."""
    nodes = [node for node in seen.nodes if not _is_tool(node.name)]
    if not nodes:
        return skipped("no node was found")
    return found(
        "warn",
        first_of([f"{node.name}: {delay}" for node in nodes for delay in node.delays]),
        "let a callback that waits be an async def, or give it a callback group of its own",
        counted(len(nodes), "node"),
    )


def check_conflicts(seen: Examination) -> Finding:
    """Each frame has one publisher."""
    return _of_tree(seen, "conflict", "fail", "stop one of the two, or rename one of the frames")


def check_loops(seen: Examination) -> Finding:
    """No edges make a loop."""
    return _of_tree(
        seen, "loop", "fail", "swap parent and child of the edge that points the wrong way"
    )


def check_orphans(seen: Examination) -> Finding:
    """No frame is alone."""
    return _of_tree(seen, "orphan", "warn", "publish a transform that connects it to the others")


def check_disconnected(seen: Examination) -> Finding:
    """All frames are in one tree."""
    apart = [each.frames[0] for each in seen.tree.problems() if each.kind == "disconnected"]
    is_listed = bool(apart) and all(name in seen.tree.claims for name in apart)
    return _of_tree(
        seen,
        "disconnected",
        "warn",
        # Its publisher knows the parent, and sends nothing.
        "see silent: the transform between the trees is listed, and has not come"
        if is_listed
        else "publish a transform between the trees; look for a misspelled parent",
    )


def check_gone(seen: Examination) -> Finding:
    """The publisher of each frame runs."""
    return _of_tree(
        seen, "gone", "warn", "start it again, or check the link to its host if it runs"
    )


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
        first_of(sentences),
        "see whether its node still sends (tfbus monitor), and what it waits for",
        counted(len(tree.frames), "frame"),
    )


def check_silent(seen: Examination) -> Finding:
    """Each announced frame is sent."""
    return _of_tree(
        seen,
        "silent",
        "warn",
        "check whether its node still sends (tfbus monitor), and its options",
    )


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


def _of_tree(seen: Examination, kind: ProblemKind, verdict: Verdict, remedy: str) -> Finding:
    sentences = [problem.text for problem in seen.tree.problems() if problem.kind == kind]
    if not sentences and not seen.tree.frames:
        return skipped(_NO_FRAME)
    return found(verdict, first_of(sentences), remedy, counted(len(seen.tree.frames), "frame"))
