"""A buffer shows its frames: as values, as tf2's dumps, as text and as a drawing."""

import sys
import xml.etree.ElementTree as ElementTree
from types import SimpleNamespace
from typing import Any

import pytest
import yaml

from tests.builders import moved
from tfbus.base.errors import InvalidArgumentException
from tfbus.buffer.buffer import Buffer
from tfbus.buffer.formats import as_dot, as_text, as_yaml, show
from tfbus.geometry.transform import Transform, TransformStamped

S = 1_000_000_000


def robot() -> Buffer:
    buffer = Buffer()
    for i in range(11):
        buffer.set_transform(
            TransformStamped(i * S // 10, "world", "base", Transform()), authority="odometry"
        )
    buffer.set_transform(TransformStamped(0, "base", "camera", Transform()), static=True)
    buffer.set_transform(TransformStamped(0, "base", "arm<1>", Transform()), authority="arm's")
    return buffer


def test_a_frame_tells_about_itself():
    """Parent, children, rate, span, count and publisher of one frame."""
    info = robot().frame("base")
    assert (info.parent, info.children, info.static) == ("world", ("arm<1>", "camera"), False)
    assert (info.samples, info.rate_hz, info.authority) == (11, 10.0, "odometry")
    assert (info.oldest_ns, info.newest_ns) == (0, S)
    assert robot().frame("camera").static
    assert robot().frame("world").parent is None
    assert [frame.name for frame in robot().all_frames()] == robot().frames()


def test_the_yaml_has_tf2s_form():
    """Every edge by its child, with tf2's keys; an empty buffer is an empty list."""
    frames = yaml.safe_load(as_yaml(robot().all_frames()))
    assert frames["base"] == {
        "parent": "world",
        "broadcaster": "odometry",
        "rate": 10.0,
        "most_recent_transform": 1.0,
        "oldest_transform": 0.0,
        "buffer_length": 1.0,
    }
    assert frames["camera"]["rate"] == 10000.0
    assert frames["arm<1>"]["broadcaster"] == "arm's"
    assert yaml.safe_load(as_yaml(Buffer().all_frames())) == []


def test_the_graph_has_tf2s_form():
    """An edge a line, from parent to child, with a legend."""
    dot = as_dot(robot().all_frames())
    assert dot.startswith("digraph G {\n")
    assert '"world" -> "base" [label="Broadcaster: odometry\\nAverage rate: 10.000 Hz' in dot
    assert "view_frames Result" in dot
    assert "no tf data" in as_dot(Buffer().all_frames())


def test_the_text_is_a_tree():
    """Children stand below their parent."""
    assert as_text(robot().all_frames()).splitlines() == [
        "world",
        "└─ base  (10.0 Hz, by odometry)",
        "   ├─ arm<1>  (1 sample, by arm's)",
        "   └─ camera  (static)",
    ]


def test_a_notebook_shows_a_drawing():
    """The SVG is well-formed and has every frame in it, with a line from its parent."""
    svg = robot()._repr_svg_()
    drawing = ElementTree.fromstring(svg)
    world, base, *leaves = (
        (int(each.attrib["cx"]), int(each.attrib["cy"])) for each in drawing.iterfind("{*}circle")
    )
    assert [each.attrib["d"] for each in drawing.iterfind("{*}path")] == [
        f"M{up_x} {up_y + 6}V{y}H{x - 6}"
        for (up_x, up_y), (x, y) in [(world, base), *((base, leaf) for leaf in leaves)]
    ]
    for name in ("world", "base", "camera", "arm&lt;1&gt;"):
        assert f">{name}<" in svg


def test_the_text_of_a_deep_chain_does_not_grow_with_the_square_of_its_depth():
    """Branches are drawn for 100 levels; the depth of what is deeper is a number."""
    buffer = Buffer()
    for i in range(1_000):
        buffer.set_transform(TransformStamped(0, f"f{i}", f"f{i + 1}", Transform()), static=True)
    lines = as_text(buffer.all_frames()).splitlines()
    assert lines[100] == f"{'   ' * 99}└─ f100  (static)"
    assert lines[101] == f"{'   ' * 100}[101] f101  (static)"
    assert lines[1_000] == f"{'   ' * 100}[1000] f1000  (static)"


def arm() -> Buffer:
    """An arm with a tool, a camera beside it, and a dock apart."""
    buffer = Buffer()
    buffer.set_transform(moved(1 * S, "base", "arm", 1.0), authority="joints")
    buffer.set_transform(moved(1 * S, "arm", "tool", 0.5), static=True)
    buffer.set_transform(moved(1 * S, "base", "camera", 2.0), static=True)
    buffer.set_transform(moved(1 * S, "yard", "dock", 2.0), static=True)
    return buffer


def test_show_prints_the_trees(capsys: pytest.CaptureFixture[str]) -> None:
    """Outside of a notebook it is text."""
    show(arm())
    assert capsys.readouterr().out.splitlines() == [
        "base",
        "├─ arm  (1 sample, by joints)",
        "│  └─ tool  (static)",
        "└─ camera  (static)",
        "yard",
        "└─ dock  (static)",
    ]


def test_show_marks_a_path_and_says_its_transform(capsys: pytest.CaptureFixture[str]) -> None:
    """The frames of the path have a star, the others none."""
    show(arm(), "base", "tool")
    lines = capsys.readouterr().out.splitlines()
    assert [line.split("  (")[0] for line in lines[:4]] == [
        "base *",
        "├─ arm *",
        "│  └─ tool *",
        "└─ camera",
    ]
    assert lines[-3:] == [
        "tool seen from base at 1.000000000 s:",
        "x, y, z in m: 1.500, 0.000, 0.000",
        "roll, pitch, yaw in degrees: 0.00, 0.00, 0.00",
    ]


def test_show_says_why_there_is_no_transform(capsys: pytest.CaptureFixture[str]) -> None:
    """For frames of separate trees, and for a time without data."""
    show(arm(), "base", "dock")
    assert "'dock' are not connected" in capsys.readouterr().out
    show(arm(), "base", "tool", 5 * S)
    assert "data for 'base' -> 'arm'" in capsys.readouterr().out


def test_show_says_that_a_frame_is_unknown(capsys: pytest.CaptureFixture[str]) -> None:
    """Below the trees, with the name that is meant; also of a buffer without frames."""
    show(arm(), "base", "toll")
    shown = capsys.readouterr().out.splitlines()
    assert shown[0] == "base *" and "no frame 'toll'" in shown[-1] and "'tool'" in shown[-1]
    show(Buffer(), "base", "toll")
    assert "there is no frame" in capsys.readouterr().out


def test_show_of_one_frame_alone_raises() -> None:
    """A path has two ends, and each has a name."""
    with pytest.raises(InvalidArgumentException, match="must not be empty"):
        show(arm(), "base", "")
    with pytest.raises(InvalidArgumentException, match="name two frames"):
        show(arm(), "base")


def test_an_empty_buffer_says_so(capsys: pytest.CaptureFixture[str]) -> None:
    """As text and as a drawing."""
    show(Buffer())
    assert capsys.readouterr().out == "no frames yet\n"
    assert "no frames yet" in Buffer()._repr_html_()
    assert "no frames yet" in Buffer()._repr_svg_()


@pytest.fixture
def notebook(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """All that is displayed in a notebook."""
    shown: list[Any] = []
    ipython = SimpleNamespace(
        get_ipython=lambda: object(), display=SimpleNamespace(display=shown.append)
    )
    monkeypatch.setitem(sys.modules, "IPython", ipython)
    return shown


def test_a_notebook_gets_a_drawing(notebook: list[Any]) -> None:
    """With the path in colour, and the transform below, all escaped."""
    buffer = arm()
    buffer.set_transform(moved(1 * S, "base", "<b>"), static=True)
    show(buffer, "base", "<b>")
    html = notebook[0]._repr_html_()
    assert "<svg" in html
    assert html.count('stroke-width="3"') == 1
    assert "<b>" not in html
    assert "&lt;b&gt; seen from" in html


def test_a_notebook_gets_the_reason_below_the_drawing(notebook: list[Any]) -> None:
    """If there is no transform."""
    show(arm(), "base", "toll")
    assert "there is no frame" in notebook[0]._repr_html_()
