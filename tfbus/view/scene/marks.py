"""Marks at the origins of frames; that of the selected frame, in each browser its own."""

from typing import Any

import numpy as np
import viser

from tfbus.view.model.placement import Placed
from tfbus.view.model.shown_frames import FAULTS, Frames
from tfbus.view.model.view_state import Selections
from tfbus.view.scene.axes import NO_POSITIONS, NO_QUATERNIONS, place
from tfbus.view.scene.shapes import octahedron

# The radius of a mark, in parts of an axis.
_MARK = 0.14

_SELECTED = (255, 150, 0)


def add_marks(scene: viser.SceneApi, path: str) -> Any:
    """A batch of marks, hidden at first."""
    return scene.add_batched_meshes_simple(
        path,
        *octahedron(_MARK),
        NO_QUATERNIONS,
        NO_POSITIONS,
        batched_scales=np.ones(1),
        batched_colors=_SELECTED,
        cast_shadow=False,
        receive_shadow=False,
        visible=False,
    )


class SelectedMarks:
    """Marks in each browser the frame that it has selected, unless its state has a mark."""

    def __init__(self, server: viser.ViserServer, selections: Selections) -> None:
        self._server = server
        self._selections = selections
        self._marks: dict[int, Any] = {}

    def draw(self, frames: Frames, placed: Placed, size: float) -> None:
        """Move the marks to where the selected frames are."""
        marks = {}
        for number, client in self._server.get_clients().items():
            mark = self._marks.get(number) or add_marks(client.scene, "/selected")
            marks[number] = mark
            name = self._selections.of(number)
            is_marked = name in placed.index and frames[name].state not in FAULTS
            rows = np.array([placed.index[name]] if is_marked else [], np.intp)
            place(mark, placed.xyz[rows], NO_QUATERNIONS[: len(rows)], size)
        self._marks = marks
