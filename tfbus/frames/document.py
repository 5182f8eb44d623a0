"""The tree of frames for other programs: JSON, tf2's YAML and graph, Mermaid."""

import json
import textwrap
from dataclasses import asdict
from typing import Any

from tfbus.buffer.formats import as_dot, as_yaml
from tfbus.frames.snapshot import FrameTree
from tfbus.frames.state import facts
from tfbus.frames.text import publisher_lines, tree_lines


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
    return json.dumps(as_map(tree), indent=2) + "\n"


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
        lines += _wrapped(line, width)
    if problems := tree.problems():
        lines += ["", "Problems:"]
        for problem in problems:
            lines += _wrapped(f"{problem.kind}: {problem.text}", width)
    return lines


def _wrapped(line: str, width: int) -> list[str]:
    """The line wrapped and indented, from its second line on by more; words stay whole."""
    return textwrap.wrap(
        line,
        width,
        initial_indent="  ",
        subsequent_indent="    ",
        break_long_words=False,
        break_on_hyphens=False,
    )


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
