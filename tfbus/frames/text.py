"""The tree of frames as lines of text."""

from collections.abc import Callable, Iterator

from tfbus.buffer.formats import branch
from tfbus.buffer.info import FrameInfo
from tfbus.frames.snapshot import FrameTree, who
from tfbus.frames.state import State, facts, state
from tfbus.wording import age, columns, counted, cut, duration, stamp_text

Paint = Callable[[str, State], str]


def plain(text: str, state: State) -> str:
    """The text as it is, in every state."""
    return text


def tree_lines(tree: FrameTree, *, width: int = 80, paint: Paint = plain) -> list[str]:
    """The trees, one line per frame: its name, and as many of its facts as the width allows.

    A name that is wider than that is cut. `paint(text, state)` may colour a line.
    """
    rows = [(f"{lead}{cut(frame.name, _room(lead, width))}", frame) for lead, frame in _rows(tree)]
    column = min(max((columns(name) for name, _ in rows), default=0), width // 2)
    lines = []
    for label, frame in rows:
        name = label + " " * (column - columns(label))
        line = name
        for fact in facts(tree, frame):
            joined = f"{line}{'  ' if line is name else ', '}{fact}"
            if columns(joined) > width:
                break
            line = joined
        lines.append(paint(line.rstrip(), state(tree, frame)))
    return lines


def _room(lead: str, width: int) -> int:
    """How much of a line its name may take; deep in a tree, still enough to tell names apart."""
    return max(width - len(lead), 20)


def publisher_lines(tree: FrameTree) -> list[str]:
    """A line per stream: its node, host and pid, its number of frames, and its delay."""
    lines = []
    for stream in tree.streams.values():
        parts = [f"{stream.name}: {who(stream)}", counted(len(stream.frames), "frame")]
        if not stream.alive:
            parts.append("GONE")
        if stream.delay_s is not None:
            side = "late" if stream.delay_s >= 0.0 else "ahead"
            parts.append(f"{duration(abs(stream.delay_s))} {side}")
        if stream.missed:
            parts.append(f"{counted(stream.missed, 'message')} missed")
        lines.append(", ".join(parts))
    return lines


def edge_lines(tree: FrameTree) -> list[str]:
    """Each edge with all its facts, one fact a line."""
    lines = []
    for name in sorted(tree.frames):
        frame = tree.frames[name]
        if frame.parent is not None:
            lines += [
                f"{frame.parent} -> {name}",
                *(f"  {fact}" for fact in _all_facts(tree, frame)),
            ]
    return lines


def frame_lines(tree: FrameTree, frame: FrameInfo) -> list[str]:
    """All facts of a frame's edge, one a line; for a root, that it is one."""
    return ["Root"] if frame.parent is None else list(_all_facts(tree, frame))


def _all_facts(tree: FrameTree, frame: FrameInfo) -> Iterator[str]:
    stream = tree.publisher(frame)
    gone = ", gone" if frame.gone else ""
    yield f"Publisher: {who(stream)}, stream {frame.authority!r}{gone}"
    yield f"Kind: {'static' if frame.static else 'dynamic'}"
    if not frame.static:
        rate = "unknown" if frame.rate_hz is None else f"{frame.rate_hz:.3f} Hz"
        over = f"{counted(frame.samples, 'sample')} over {duration(tree.kept_s(frame))}"
        yield f"Rate: {rate}, {over}"
        yield f"Newest: {_stamp(frame.newest_ns)}, {age(tree.age_s(frame))}"
        yield f"Oldest: {_stamp(frame.oldest_ns)}"
        yield f"Delay of its stream, smoothed: {duration(stream.delay_s)}"
    if frame.conflicts:
        yield f"Samples that replaced a different one of the same stamp: {frame.conflicts}"
    if frame.refused:
        yield f"Samples that were too old to keep: {frame.refused}"


def _rows(tree: FrameTree) -> Iterator[tuple[str, FrameInfo]]:
    """Each frame, with the branches drawn before its name."""
    for root in tree.roots:
        stack = [("", "", 0, root.name)]
        while stack:
            lead, below, depth, name = stack.pop()
            yield lead, tree.frames[name]
            children = tree.children(name)
            for child in reversed(children):
                lead, more = branch(below, depth + 1, is_last=child == children[-1])
                stack.append((lead, more, depth + 1, child))


def _stamp(stamp_ns: int | None) -> str:
    return "none" if stamp_ns is None else stamp_text(stamp_ns)
