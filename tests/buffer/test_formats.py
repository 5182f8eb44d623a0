"""A buffer shows its frames: as values, as tf2's dumps, as text and as a drawing."""

import xml.etree.ElementTree as ElementTree

import yaml

from tfbus.buffer.buffer import Buffer
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
    frames = yaml.safe_load(robot().all_frames_as_yaml())
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
    assert yaml.safe_load(Buffer().all_frames_as_yaml()) == []


def test_the_graph_has_tf2s_form():
    """An edge a line, from parent to child, with a legend."""
    dot = robot().all_frames_as_dot()
    assert dot.startswith("digraph G {\n")
    assert '"world" -> "base" [label="Broadcaster: odometry\\nAverage rate: 10.000 Hz' in dot
    assert "view_frames Result" in dot
    assert "no tf data" in Buffer().all_frames_as_dot()


def test_the_text_is_a_tree():
    """Children stand below their parent."""
    assert robot().all_frames_as_text().splitlines() == [
        "world",
        "└─ base  (10.0 Hz, by odometry)",
        "   ├─ arm<1>  (1 sample, by arm's)",
        "   └─ camera  (static)",
    ]


def test_a_notebook_shows_a_drawing():
    """The SVG is well-formed and has every frame in it."""
    svg = robot()._repr_svg_()
    ElementTree.fromstring(svg)
    for name in ("world", "base", "camera", "arm&lt;1&gt;"):
        assert f">{name}<" in svg


def test_the_text_of_a_deep_chain_does_not_grow_with_the_square_of_its_depth():
    """Branches are drawn for 100 levels; the depth of what is deeper is a number."""
    buffer = Buffer()
    for i in range(1_000):
        buffer.set_transform(TransformStamped(0, f"f{i}", f"f{i + 1}", Transform()), static=True)
    lines = buffer.all_frames_as_text().splitlines()
    assert lines[100] == f"{'   ' * 99}└─ f100  (static)"
    assert lines[101] == f"{'   ' * 100}[101] f101  (static)"
    assert lines[1_000] == f"{'   ' * 100}[1000] f1000  (static)"
