"""The colours and the fading of frames in the scene, by their states."""

from collections.abc import Sequence

import numpy as np

from tfbus.frames.state import State
from tfbus.view.model.placement import arrow_rows
from tfbus.view.model.settings import ViewSettings
from tfbus.view.model.shown_frames import FAULTS, Frames

Rgb = tuple[int, int, int]

# Of arrows and marks; they differ in brightness too.
COLORS: dict[State, Rgb] = {
    "dynamic": (214, 170, 40),
    "static": (70, 130, 190),
    "stale": (140, 140, 140),
    "ahead": (20, 150, 140),
    "gone": (190, 40, 40),
    "conflict": (200, 60, 190),
    "root": (140, 140, 140),
}


class Styling:
    """Opacities, colours and marks of frames, wherever they are; they change seldom."""

    def __init__(self, frames: Frames, names: Sequence[str], settings: ViewSettings) -> None:
        self.frames, self.names, self.settings = frames, names, settings
        shown = [frames[name] for name in names]
        self.opacity = settings.opacity * np.array([frame.opacity for frame in shown])
        rows = [row for row, frame in enumerate(shown) if frame.state in FAULTS]
        self.marked = np.array(rows, np.intp)
        self.mark_colors = np.array([COLORS[shown[row].state] for row in rows], np.uint8)
        parents = {frame.name: frame.info.parent for frame in shown}
        self.children, self.parents = arrow_rows(names, parents)
        colors = np.array([COLORS[frame.state] for frame in shown], np.uint8).reshape(-1, 3)
        self.arrow_colors = colors[self.children]

    def is_of(self, frames: Frames, names: Sequence[str], settings: ViewSettings) -> bool:
        """Whether it still holds for these frames and settings."""
        return frames is self.frames and settings is self.settings and names == self.names
