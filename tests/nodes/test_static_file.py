"""Static edges: fields and files."""

import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tfbus import Transform, TransformStamped
from tfbus.base.yaml_file import YamlFileError
from tfbus.nodes.static_edge import EdgeMistake, make_edge
from tfbus.nodes.static_file import read_edges

FRAMES = {"frame_id": "world", "child_frame_id": "camera"}
ANGLE = st.floats(-3.0, 3.0)


def edge(parent: str, child: str, transform: Transform) -> TransformStamped:
    return TransformStamped(0, parent, child, transform)


def test_missing_fields_are_the_identitys() -> None:
    """An edge without numbers is the identity; the default of qw is 1."""
    assert make_edge(FRAMES, {}) == edge("world", "camera", Transform.identity())
    assert make_edge(FRAMES, {"qx": 0.0, "y": 2.0}) == edge("world", "camera", Transform((0, 2, 0)))


@given(ANGLE, ANGLE, ANGLE)
def test_degrees_are_radians_of_another_size(roll: float, pitch: float, yaw: float) -> None:
    """An edge in degrees is the one whose angles in radians are as large."""
    radians = {"roll": roll, "pitch": pitch, "yaw": yaw}
    degrees = {field: math.degrees(value) for field, value in radians.items()}
    in_degrees = make_edge(FRAMES, degrees, degrees=True).transform
    assert in_degrees.is_close(make_edge(FRAMES, radians).transform)
    assert in_degrees.is_close(Transform.from_rpy(roll, pitch, yaw))


@pytest.mark.parametrize(
    ("frames", "numbers", "field", "reason"),
    [
        ({}, {}, "frame_id", "is missing"),
        ({"frame_id": "a"}, {}, "child_frame_id", "is missing"),
        (
            {"frame_id": "a", "child_frame_id": "a"},
            {},
            "child_frame_id",
            "is the parent's name too",
        ),
        ({"frame_id": "a", "child_frame_id": "/b"}, {}, "child_frame_id", "write 'b'"),
        (FRAMES, {"x": math.nan}, "x", "must be finite, not nan"),
        (FRAMES, {"qw": math.inf}, "qw", "must be finite, not inf"),
        (FRAMES, {"yaw": 1.0, "qz": 1.0}, "qz", "cannot be combined with yaw"),
        (FRAMES, {"qx": 1.0, "qw": 1.0}, "qx", "divided by its norm it is qx 0.707106781 "),
        (FRAMES, {"qw": 0.0}, "qw", "norm 0"),
    ],
)
def test_an_invalid_edge_names_the_field(
    frames: dict[str, str], numbers: dict[str, float], field: str, reason: str
) -> None:
    """A mistake in an edge names the field and what is allowed."""
    with pytest.raises(EdgeMistake) as raised:
        make_edge(frames, numbers)
    assert raised.value.field == field
    assert reason in raised.value.reason


def test_a_file_holds_many_edges(tmp_path: Path) -> None:
    """A file is a list of edges whose keys are the flags, with angles in degrees on request."""
    path = tmp_path / "edges.yaml"
    path.write_text(
        """\
- {frame_id: world, child_frame_id: camera, x: 1, yaw: 0.5}
- frame_id: camera
  child_frame_id: lens
  z: 2e-2
  roll: 90
  deg: true
- {frame_id: world, child_frame_id: 007, qz: 1, qw: 0}
"""
    )
    camera, lens, other = read_edges(path)
    assert camera == edge("world", "camera", Transform.from_rpy(0, 0, 0.5, xyz=(1, 0, 0)))
    assert lens.transform.is_close(Transform.from_rpy(math.pi / 2, 0, 0, xyz=(0, 0, 0.02)))
    assert other == edge("world", "007", Transform(quat_xyzw=(0, 0, 1, 0)))


def test_degrees_can_hold_for_a_whole_file(tmp_path: Path) -> None:
    """`--deg` is the default of `deg` for each edge."""
    path = tmp_path / "edges.yaml"
    path.write_text(
        "- {frame_id: a, child_frame_id: b, yaw: 90}\n"
        "- {frame_id: a, child_frame_id: c, yaw: 1.5, deg: false}\n"
    )
    b, c = read_edges(path, degrees=True)
    assert b.transform.is_close(Transform.from_rpy(0, 0, math.pi / 2))
    assert c.transform.is_close(Transform.from_rpy(0, 0, 1.5))


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", "edges.yaml:1: is empty; write a list of edges"),
        ("[]", "edges.yaml:1: is empty; write a list of edges"),
        ("a: 1", "edges.yaml:1: must be a list, not a mapping"),
        ("- a", r"edges.yaml:1: \[0\]: must be a mapping .*, not one value"),
        ("- {frame_id: a\n", "edges.yaml:1: is not YAML"),
        ("- frame_id: a\n  yawn: 1", r"edges.yaml:2: \[0\].yawn: unknown key .*did you mean 'yaw'"),
        (
            "- frame_id: a\n  x: 1\n  x: 2",
            r"edges.yaml:3: \[\d\].x: is written twice, first in line 2",
        ),
        (
            "- frame_id: a\n  child_frame_id: [b]",
            r"edges.yaml:2: \[\d\].child_frame_id: must be one value",
        ),
        (
            "- frame_id: a\n  child_frame_id: b\n  x: one",
            r"edges.yaml:3: \[\d\].x: 'one' is not a number",
        ),
        (
            "- frame_id: a\n  child_frame_id: b\n  x: .nan",
            r"edges.yaml:3: \[\d\].x: '.nan' is not a",
        ),
        ("- frame_id: a\n  child_frame_id: b\n  x:", r"edges.yaml:3: \[\d\].x: has no value"),
        (
            "- frame_id: a\n  child_frame_id: b\n  x: inf",
            r"edges.yaml:3: \[\d\].x: must be finite, not inf",
        ),
        (
            "- frame_id: a\n  child_frame_id: b\n  deg: 1",
            r"edges.yaml:3: \[\d\].deg: must be true or false, not '1'",
        ),
        ("- frame_id: a\n  x: 1", "edges.yaml:1: \\[0\\]: child_frame_id is missing"),
        (
            "- frame_id: a\n  child_frame_id: a",
            r"edges.yaml:2: \[\d\].child_frame_id: 'a' is the parent's name",
        ),
        (
            "- {frame_id: a, child_frame_id: b}\n- {frame_id: c, child_frame_id: b}",
            r"edges.yaml:2: \[\d\].child_frame_id: 'b' already has a parent, in line 1",
        ),
        (
            "- {frame_id: a, child_frame_id: b}\n- {frame_id: b, child_frame_id: a}",
            r"edges.yaml:2: \[\d\].child_frame_id: .*would close a loop",
        ),
    ],
)
def test_a_mistake_in_a_file_gets_its_line_and_key(
    tmp_path: Path, text: str, complaint: str
) -> None:
    """The error for any mistake in a file has its line and key, and what is allowed."""
    path = tmp_path / "edges.yaml"
    path.write_text(text)
    with pytest.raises(YamlFileError, match=complaint):
        read_edges(path)


def test_a_file_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    """The error names a file that does not exist or is not text."""
    with pytest.raises(YamlFileError, match=r"none\.yaml .*: No such"):
        read_edges(tmp_path / "none.yaml")
    (tmp_path / "binary.yaml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(YamlFileError, match=r"binary\.yaml .* text file"):
        read_edges(tmp_path / "binary.yaml")
