"""The tree of frames, and single transforms, written out as text, JSON, CSV, YAML or a graph.

A transform is text as tf2_echo prints it, JSON or CSV, without a final line break. Lengths are in
metres, angles in radians unless a label says degrees; quaternions are x, y, z, w.
"""

import csv
import io
import json
import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass
from typing import Any

from tfbus.base.json_text import json_text
from tfbus.base.wording import (
    age,
    columns,
    counted,
    cut,
    duration,
    natural_order,
    stamp_text,
    wrapped,
)
from tfbus.buffer.formats import as_dot, as_yaml, branch
from tfbus.buffer.info import FrameInfo
from tfbus.frames.moment import State, facts, state
from tfbus.frames.snapshot import FrameTree, who
from tfbus.geometry.rotations import matrix_of
from tfbus.geometry.trajectory import CSV_COLUMNS
from tfbus.geometry.transform import TransformStamped

Paint = Callable[[str, State], str]

# Before the first line of a problem, and before its others.
_INDENTED = ("  ", "    ")


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
    for name in sorted(tree.frames, key=natural_order):
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


def as_map(tree: FrameTree) -> dict[str, Any]:
    """The tree in maps and lists; times in ns or s, as their names say."""
    return {
        "recorded_ns": tree.recorded_ns,
        "roots": [root.name for root in tree.roots],
        "frames": [
            asdict(frame)
            | {
                "age_s": tree.age_s(frame),
                "kept_s": tree.kept_s(frame),
                "delay_s": None if frame.static else tree.publisher(frame).delay_s,
                "node": tree.publisher(frame).node,
                "host": tree.publisher(frame).host,
                "conflict": name in tree.conflicts,
            }
            for name, frame in sorted(tree.frames.items())
        ],
        "streams": [asdict(stream) for stream in tree.streams.values()],
        "problems": [asdict(problem) for problem in tree.problems()],
    }


def as_json(tree: FrameTree) -> str:
    """`as_map` as one JSON object."""
    return json_text(as_map(tree), indent=2) + "\n"


def as_tf2_yaml(tree: FrameTree) -> str:
    """The edges in the form of tf2's `allFramesAsYAML`."""
    return as_yaml(tree.frames.values())


def as_tf2_dot(tree: FrameTree) -> str:
    """A Graphviz graph in the form of tf2's view_frames."""
    return as_dot(tree.frames.values(), tree.recorded_ns)


def as_mermaid(tree: FrameTree) -> str:
    """A Mermaid flowchart, which many wikis and READMEs draw."""
    number = {name: f"f{at}" for at, name in enumerate(sorted(tree.frames))}
    lines = ["flowchart TD"]
    lines += [f'  {number[name]}["{_mermaid(name)}"]' for name in number]
    for name, frame in sorted(tree.frames.items()):
        if frame.parent in number:
            label = "<br/>".join(_mermaid(fact) for fact in facts(tree, frame)[:3])
            arrow = "-.->" if frame.gone else "-->"
            lines.append(f'  {number[frame.parent]} {arrow}|"{label}"| {number[name]}')
    return "\n".join(lines) + "\n"


def as_text(tree: FrameTree) -> str:
    """The trees, their publishers and problems, as `tfbus frames` prints them."""
    return "\n".join(summary(tree)) + "\n"


def summary(tree: FrameTree, tree_part: list[str] | None = None, *, width: int = 80) -> list[str]:
    """The lines of the tree, its publishers, then its problems; wrapped to `width` characters.

    `tree_part` replaces the lines of the tree.
    """
    lines = tree_lines(tree, width=width) if tree_part is None else list(tree_part)
    lines += ["", "Publishers:"]
    for line in publisher_lines(tree):
        lines += wrapped(line, width, *_INDENTED, break_words=False)
    if problems := tree.problems():
        lines += ["", "Problems:"]
        for problem in problems:
            text = f"{problem.kind}: {problem.text}"
            lines += wrapped(text, width, *_INDENTED, break_words=False)
    return lines


def _mermaid(text: str) -> str:
    # `#` begins an escape in Mermaid, and a backtick a text in Markdown.
    for sign, escaped in {
        "#": "#35;",
        "&": "&amp;",
        '"': "&quot;",
        "<": "&lt;",
        "`": "#96;",
    }.items():
        text = text.replace(sign, escaped)
    return text


CSV_HEADER = ",".join(CSV_COLUMNS)


@dataclass(frozen=True)
class Numbers:
    """How numbers are written: digits after the point, and the sign of a zero.

    tf2_echo writes `-0.000` for negative numbers that round to zero; here only `raw_zeros` does.
    """

    precision: int = 3
    raw_zeros: bool = False

    def text(self, value: float) -> str:
        """The number with `precision` digits: `0.112`."""
        text = f"{value:.{self.precision}f}"
        is_negative_zero = text.startswith("-") and not text.strip("-0.")
        return text[1:] if is_negative_zero and not self.raw_zeros else text

    def bracketed(self, values: Iterable[float]) -> str:
        """The numbers in brackets: `[0.000, 0.000, 0.224]`."""
        return f"[{', '.join(map(self.text, values))}]"

    def exact(self, values: Iterable[float]) -> list[float]:
        """The numbers with all their digits, for formats that machines read."""
        # Adding 0.0 turns -0.0 into 0.0 and leaves every other number as it is.
        return [float(value) if self.raw_zeros else float(value) + 0.0 for value in values]


def tf2_block(transform: TransformStamped, numbers: Numbers) -> str:
    """The block of nine lines that tf2_echo prints since 2025."""
    roll, pitch, yaw = transform.transform.as_rpy()
    pose = transform.transform.as_pose()
    # tf2 computes pitch as -asin(m20), so that a pitch of zero is -0.0 there.
    rpy = (roll, pitch or -0.0, yaw)
    return "\n".join(
        (
            f"At time {stamp_text(transform.stamp_ns)}",
            f"- Translation: {numbers.bracketed(pose[:3])}",
            f"- Rotation: in Quaternion (xyzw) {numbers.bracketed(pose[3:])}",
            f"- Rotation: in RPY (radian) {numbers.bracketed(rpy)}",
            f"- Rotation: in RPY (degree) {numbers.bracketed(map(math.degrees, rpy))}",
            "- Matrix:",
            *_matrix_rows(transform, numbers),
        )
    )


def foxy_block(transform: TransformStamped, numbers: Numbers) -> str:
    """The block of three lines that tf2_echo printed up to ROS 2 Foxy."""
    return "\n".join(
        (
            f"At time {stamp_text(transform.stamp_ns)}",
            f"- Translation: {numbers.bracketed(transform.transform.as_pose()[:3])}",
            f"- Rotation: in Quaternion {numbers.bracketed(transform.transform.as_pose()[3:])}",
        )
    )


def short_line(transform: TransformStamped, numbers: Numbers) -> str:
    """A line for people: the stamp in seconds, the position, and the angles in degrees."""
    degrees = map(math.degrees, transform.transform.as_rpy())
    xyz = numbers.bracketed(transform.transform.xyz)
    rpy = numbers.bracketed(degrees)
    return f"{transform.stamp_ns / 1e9:.3f}: xyz {xyz} m, rpy {rpy} degrees"


def json_line(transform: TransformStamped, numbers: Numbers) -> str:
    """One JSON object in one line, its numbers with all their digits."""
    pose = transform.transform
    return json.dumps(
        {
            "stamp_ns": transform.stamp_ns,
            "frame_id": transform.frame_id,
            "child_frame_id": transform.child_frame_id,
            "xyz": numbers.exact(pose.as_pose()[:3]),
            "quat_xyzw": numbers.exact(pose.as_pose()[3:]),
            "rpy": numbers.exact(pose.as_rpy()),
        },
        ensure_ascii=False,
    )


def csv_line(transform: TransformStamped, numbers: Numbers) -> str:
    """A row with the columns of CSV_HEADER, its numbers with all their digits."""
    pose = transform.transform
    row = io.StringIO()
    csv.writer(row, lineterminator="").writerow(
        (
            transform.stamp_ns,
            transform.frame_id,
            transform.child_frame_id,
            *numbers.exact((*pose.as_pose(), *pose.as_rpy())),
        )
    )
    return row.getvalue()


def _matrix_rows(transform: TransformStamped, numbers: Numbers) -> list[str]:
    # tf2_echo's columns are six wide for its three digits; more digits need wider ones.
    width = max(6, numbers.precision + 3)
    pose = transform.transform.as_pose()
    turned = zip(matrix_of(*pose[3:]), pose[:3], strict=True)
    rows = [*((*row, moved) for row, moved in turned), (0.0, 0.0, 0.0, 1.0)]
    return ["".join(f" {numbers.text(value):>{width}}" for value in row) for row in rows]
