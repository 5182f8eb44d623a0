"""A buffer as people look at it: drawn in a notebook, or as text."""

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass

from tfbus.buffer.formats import as_svg, as_text
from tfbus.buffer.info import FrameInfo
from tfbus.errors import TransformException
from tfbus.geometry.transform import TransformStamped
from tfbus.wording import stamp_text


@dataclass(frozen=True)
class Drawing:
    """The trees of a buffer, and with a path the transform along it, or why there is none."""

    frames: Sequence[FrameInfo]
    path: tuple[str, ...] = ()
    answer: TransformStamped | TransformException | None = None

    def __str__(self) -> str:
        tree = as_text(self.frames, self.path) if self.frames else "no frames yet"
        return tree if self.answer is None else f"{tree}\n\n{said(self.answer)}"

    __repr__ = __str__

    def _repr_html_(self) -> str:
        drawn = f'<div style="overflow-x:auto">{as_svg(self.frames, self.path)}</div>'
        if self.answer is None:
            return drawn
        from html import escape  # slow to import, and few draw

        return f"{drawn}<pre>{escape(said(self.answer))}</pre>"


def said(answer: TransformStamped | TransformException) -> str:
    """The transform in numbers for people, or why there is none."""
    if isinstance(answer, TransformException):
        return str(answer)
    pose = answer.transform
    xyz = ", ".join(f"{value + 0.0:.3f}" for value in pose.xyz)
    rpy = ", ".join(f"{math.degrees(value) + 0.0:.2f}" for value in pose.as_rpy())
    when = f" at {stamp_text(answer.stamp_ns)} s" if answer.stamp_ns else ""
    return (
        f"{answer.child_frame_id} seen from {answer.frame_id}{when}:\n"
        f"x, y, z in m: {xyz}\nroll, pitch, yaw in degrees: {rpy}"
    )


def display(drawing: Drawing) -> None:
    """Show a drawing in the notebook, or at the prompt of IPython; elsewhere print it."""
    ipython = sys.modules.get("IPython")
    if ipython is not None and ipython.get_ipython() is not None:
        ipython.display.display(drawing)
    else:
        print(drawing)
