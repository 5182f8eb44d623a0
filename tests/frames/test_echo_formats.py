"""The exact output of `tfbus echo`."""

import csv
import json
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tfbus import Transform, TransformStamped
from tfbus.frames.document import (
    CSV_HEADER,
    Numbers,
    csv_line,
    foxy_block,
    json_line,
    short_line,
    tf2_block,
)

PLANAR = TransformStamped(
    1_670_400_305_009_085_308,
    "world",
    "turtle1",
    Transform.from_rpy(0.0, 0.0, 0.224, xyz=(8.435, 5.871, 0.0)),
)
THREE_DECIMALS = Numbers()


def moved(x: float, y: float = 0.0) -> TransformStamped:
    return TransformStamped(0, "world", "turtle1", Transform((x, y, 0.0)))


def test_the_block_is_tf2_echos() -> None:
    """The default block is that of the newest tf2_echo, with every nanosecond and no -0.000."""
    assert tf2_block(PLANAR, THREE_DECIMALS) == (
        "At time 1670400305.009085308\n"
        "- Translation: [8.435, 5.871, 0.000]\n"
        "- Rotation: in Quaternion (xyzw) [0.000, 0.000, 0.112, 0.994]\n"
        "- Rotation: in RPY (radian) [0.000, 0.000, 0.224]\n"
        "- Rotation: in RPY (degree) [0.000, 0.000, 12.834]\n"
        "- Matrix:\n"
        "  0.975 -0.222  0.000  8.435\n"
        "  0.222  0.975  0.000  5.871\n"
        "  0.000  0.000  1.000  0.000\n"
        "  0.000  0.000  0.000  1.000"
    )


def test_raw_zeros_are_tf2_echos_own() -> None:
    """With raw zeros the pitch of a plane motion is `-0.000`, as tf2_echo prints it."""
    block = tf2_block(PLANAR, Numbers(raw_zeros=True))
    assert "- Rotation: in RPY (radian) [0.000, -0.000, 0.224]\n" in block
    assert "- Rotation: in RPY (degree) [0.000, -0.000, 12.834]\n" in block


def test_the_foxy_block_has_three_lines() -> None:
    """`--style foxy` is the block of the older tf2_echo."""
    drone = TransformStamped(
        1_649_109_418_661_570_822, "world", "drone", Transform((-2.552, 0.0, -0.0))
    )
    assert foxy_block(drone, THREE_DECIMALS) == (
        "At time 1649109418.661570822\n"
        "- Translation: [-2.552, 0.000, 0.000]\n"
        "- Rotation: in Quaternion [0.000, 0.000, 0.000, 1.000]"
    )


def test_precision_sets_the_digits_and_keeps_the_columns() -> None:
    """More digits make every number longer, and the columns of the matrix wider."""
    rows = tf2_block(PLANAR, Numbers(precision=6)).split("\n")
    assert rows[1] == "- Translation: [8.435000, 5.871000, 0.000000]"
    assert rows[6:8] == [
        "  0.975017 -0.222131  0.000000  8.435000",
        "  0.222131  0.975017  0.000000  5.871000",
    ]
    assert tf2_block(moved(1.6), Numbers(precision=0)).split("\n")[1] == "- Translation: [2, 0, 0]"


@given(st.floats(-1e6, 1e6), st.integers(0, 12))
def test_no_zero_has_a_sign_and_every_other_number_keeps_its(value: float, precision: int) -> None:
    """The text is the rounded number; only the sign of a zero is dropped."""
    text = Numbers(precision).text(value)
    assert text.lstrip("-") == f"{abs(value):.{precision}f}"
    assert text.startswith("-") == (float(f"{value:.{precision}f}") < 0)


def test_the_short_form_is_one_line_in_degrees() -> None:
    """It has the stamp in seconds, metres and degrees, with the precision asked for."""
    transform = TransformStamped(
        1_500_000_000, "world", "drone", Transform.from_rpy(0.0, 0.0, math.pi / 2, (1.0, 2.5, 0.0))
    )
    assert short_line(transform, Numbers(precision=1)) == (
        "1.500: xyz [1.0, 2.5, 0.0] m, rpy [0.0, 0.0, 90.0] degrees"
    )


def test_json_is_one_object_in_one_line_with_all_digits() -> None:
    """JSON has frames, stamp and pose under field names, nothing rounded."""
    transform = TransformStamped(
        7, "world", 'odd "näme"', Transform((0.1, -0.0, 1 / 3), (0.0, 0.0, 0.6, 0.8))
    )
    line = json_line(transform, THREE_DECIMALS)
    assert "\n" not in line
    assert "-0.0" not in line
    assert json.loads(line) == {
        "stamp_ns": 7,
        "frame_id": "world",
        "child_frame_id": 'odd "näme"',
        "xyz": [0.1, 0.0, 1 / 3],
        "quat_xyzw": [0.0, 0.0, 0.6, 0.8],
        "rpy": pytest.approx([0.0, 0.0, 2 * math.atan2(0.6, 0.8)]),
    }


def test_csv_has_a_column_for_every_name_of_its_header() -> None:
    """A CSV row is read back by its header, frame names with commas too."""
    transform = TransformStamped(7, "world, old", "turtle1", Transform((1.5, -0.0, 1 / 3)))
    (row,) = csv.DictReader([CSV_HEADER, csv_line(transform, THREE_DECIMALS)])
    assert row == {
        "stamp_ns": "7",
        "frame_id": "world, old",
        "child_frame_id": "turtle1",
        "x": "1.5",
        "y": "0.0",
        "z": "0.3333333333333333",
        "qx": "0.0",
        "qy": "0.0",
        "qz": "0.0",
        "qw": "1.0",
        "roll": "0.0",
        "pitch": "0.0",
        "yaw": "0.0",
    }
