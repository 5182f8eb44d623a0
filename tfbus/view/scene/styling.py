"""The colours and the fading of frames in the scene, by their states."""

from collections.abc import Sequence

import numpy as np

from tfbus.view.model.frames import Frames
from tfbus.view.model.placement import arrow_rows
from tfbus.view.model.settings import ViewSettings
from tfbus.view.model.status import FrameState, Status

Rgb = tuple[int, int, int]

# Of arrows and marks, and told apart in brightness too.
COLORS: dict[Status, Rgb] = {
    Status.FRESH: (214, 170, 40),
    Status.STATIC: (70, 130, 190),
    Status.STALE: (140, 140, 140),
    Status.GONE: (190, 40, 40),
    Status.CONFLICT: (200, 60, 190),
    Status.ROOT: (140, 140, 140),
}
_MARKED = (Status.STALE, Status.GONE, Status.CONFLICT)
SELECTED = (255, 150, 0)


class Looks:
    """How frames look, whatever their places: it changes seldom."""

    def __init__(self, frames: Frames, names: Sequence[str], settings: ViewSettings) -> None:
        self.frames, self.names, self.settings = frames, names, settings
        states = [frames.states[name] for name in names]
        self.opacity = settings.opacity * np.array([state.opacity for state in states])
        rows = [row for row, state in enumerate(states) if _is_marked(state, settings)]
        self.marked = np.array(rows, np.intp)
        self.mark_colors = np.array([_mark_color(states[row]) for row in rows], np.uint8)
        parents = {state.name: state.info.parent for state in states}
        self.children, self.parents = arrow_rows(names, parents)
        colors = np.array([COLORS[state.status] for state in states], np.uint8).reshape(-1, 3)
        self.arrow_colors = colors[self.children]

    def are_of(self, frames: Frames, names: Sequence[str], settings: ViewSettings) -> bool:
        """Whether they are still those of these frames, so chosen."""
        return frames is self.frames and settings is self.settings and names == self.names


def _is_marked(state: FrameState, settings: ViewSettings) -> bool:
    return state.status in _MARKED or state.name == settings.selected


def _mark_color(state: FrameState) -> Rgb:
    return COLORS[state.status] if state.status in _MARKED else SELECTED
