"""Checks of the nodes, and of the tree of frames."""

from collections import defaultdict

from tfbus.doctor.examination import Examination
from tfbus.doctor.finding import Finding, Verdict, first_of, found
from tfbus.frames.snapshot import ProblemKind, who
from tfbus.frames.state import silent_s, state
from tfbus.wording import counted, duration


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
    return found(
        "fail",
        doubled,
        "give each its own name (--name) or namespace (--namespace)",
        counted(len(seen.nodes), "node"),
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
    return _of_tree(
        seen,
        "disconnected",
        "warn",
        "publish a transform between the trees; look for a misspelled parent",
    )


def check_gone(seen: Examination) -> Finding:
    """The publisher of each frame runs."""
    return _of_tree(seen, "gone", "warn", "start it again, or remove its frames from the tree")


def check_stale(seen: Examination) -> Finding:
    """Samples of each dynamic frame still come."""
    tree = seen.tree
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
    return found("fail", mixed, "publish it either as static or as dynamic", "none is both")


def _of_tree(seen: Examination, kind: ProblemKind, verdict: Verdict, remedy: str) -> Finding:
    sentences = [problem.text for problem in seen.tree.problems() if problem.kind == kind]
    return found(verdict, first_of(sentences), remedy, counted(len(seen.tree.frames), "frame"))
