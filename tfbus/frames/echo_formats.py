"""How `tfbus echo` writes a transform: text as tf2_echo prints it, JSON, or CSV.

Each function returns the text of one transform without a final line break. Lengths are in metres,
angles in radians unless a label says degrees; quaternions are x, y, z, w.
"""

import csv
import io
import json
import math
from collections.abc import Iterable
from dataclasses import dataclass

from tfbus.geometry.rotations import matrix_of
from tfbus.geometry.transform import TransformStamped
from tfbus.trajectory.trajectory import CSV_COLUMNS
from tfbus.wording import stamp_text

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
