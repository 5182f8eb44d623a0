"""Names of frames in the scene: an object each, so that only some frames have one."""

from collections.abc import Iterable, Sequence

import numpy as np
import viser

from tfbus.nodes.viewer.placing import Floats, Placed
from tfbus.nodes.viewer.settings import ViewSettings
from tfbus.nodes.viewer.status import FrameState, Status

# More names than these could not be read anyway, and each is an object of its own.
MOST = 40

# Names nearer to each other than this part of an axis are written as one.
_TOGETHER = 0.4

_SAID = (Status.STALE, Status.GONE, Status.CONFLICT)


class Labels:
    """The names of the first frames, and of the selected one in any case."""

    def __init__(self, scene: viser.SceneApi) -> None:
        self._scene = scene
        self._shown: dict[str, viser.LabelHandle] = {}
        self._count = 0

    def draw(
        self, states: Sequence[FrameState], placed: Placed, settings: ViewSettings, size: float
    ) -> None:
        """Put names beside the frames; where names are off, beside the selected one only."""
        texts: dict[int, str] = {}
        for row, state in enumerate(states):
            if state.name == settings.selected or (settings.names and row < MOST):
                at = _near(placed.xyz, texts, row, size * _TOGETHER)
                texts[at] = f"{texts[at]}, {_text(state)}" if at in texts else _text(state)
        for name in self._shown.keys() - {states[row].name for row in texts}:
            self._shown.pop(name).remove()
        above = np.array((0.0, 0.0, 0.35 * size))
        for row, text in texts.items():
            self._put(states[row].name, text, placed.xyz[row] + above)

    def _put(self, name: str, text: str, position: Floats) -> None:
        label = self._shown.get(name)
        if label is None:
            # A frame's name may have slashes in it, which make trees of viser's objects.
            self._count += 1
            self._shown[name] = self._scene.add_label(
                f"/labels/{self._count}", text, position=position, anchor="bottom-center"
            )
            return
        if label.text != text:
            label.text = text
        label.position = position


def _text(state: FrameState) -> str:
    return f"{state.name} ({state.status.value})" if state.status in _SAID else state.name


def _near(xyz: Floats, rows: Iterable[int], row: int, reach_m: float) -> int:
    """One of the rows that is so near that the names would cover each other; else the row."""
    return next((at for at in rows if np.abs(xyz[at] - xyz[row]).max() < reach_m), row)
