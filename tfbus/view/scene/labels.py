"""Names of frames in the scene of one browser: those that can be read from its camera.

Each name is an object of its own, so there are few.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import viser

from tfbus.view.model.frames import FAULTS, Floats, Placed, ViewFrame
from tfbus.view.model.settings import Selections, ViewSettings
from tfbus.view.scene.camera import Window
from tfbus.wording import listed

# At most this many names are drawn at once.
MOST = 40

# Of this many frames at most, the nearest: more would lie behind each other.
_CONSIDERED = 200

# Frames closer together than this part of an axis share a label, which names at most three.
_TOGETHER = 0.4
_MOST_TOGETHER = 3

# A name is above its frame by this part of an axis; the rest is in pixels.
_ABOVE = 0.35
_LETTER = 6.2
_MARGIN = 10.0
_HEIGHT = 18.0

# Longer names are cut in the middle; the tree shows them whole.
_LONGEST = 32


class Names:
    """The names in the scenes of all browsers, each by its own camera."""

    def __init__(self, server: viser.ViserServer, selections: Selections) -> None:
        self._server = server
        self._selections = selections
        self._labels: dict[int, Labels] = {}

    def draw(
        self,
        frames: Sequence[ViewFrame] | None,
        placed: Placed,
        settings: ViewSettings,
        size: float,
    ) -> None:
        """Choose which of these frames have names; for None, only move the names there are."""
        clients = self._server.get_clients()
        self._labels = {
            number: self._labels.get(number) or Labels(client.scene)
            for number, client in clients.items()
        }
        for number, labels in self._labels.items():
            if frames is None:
                labels.move(placed, size)
            else:
                window = Window.of(clients[number].camera)
                own = replace(settings, selected=self._selections.of(number))
                labels.choose(frames, placed, own, size, window)


class Labels:
    """The names that one browser shows."""

    def __init__(self, scene: viser.SceneApi) -> None:
        self._scene = scene
        self._shown: dict[str, Any] = {}
        self._count = 0

    def choose(
        self,
        frames: Sequence[ViewFrame],
        placed: Placed,
        settings: ViewSettings,
        size: float,
        window: Window,
    ) -> None:
        """Write names at the frames; with names off, only at the selected one."""
        texts = readable(frames, placed.xyz, settings, size, window, frozenset(self._shown))
        for name in self._shown.keys() - texts.keys():
            self._shown.pop(name).remove()
        for name, text in texts.items():
            label = self._shown.get(name)
            if label is None:
                # Not by its name, which may have slashes: viser makes trees of them.
                self._count += 1
                self._shown[name] = self._scene.add_label(
                    f"/names/{self._count}", text, anchor="bottom-center"
                )
            elif label.text != text:
                label.text = text
        self.move(placed, size)

    def move(self, placed: Placed, size: float) -> None:
        """Keep the names above their frames; remove those of frames without a place."""
        for name in list(self._shown):
            row = placed.index.get(name)
            if row is None:
                self._shown.pop(name).remove()
            else:
                self._shown[name].position = placed.xyz[row] + (0.0, 0.0, _ABOVE * size)


def readable(
    frames: Sequence[ViewFrame],
    xyz: Floats,
    settings: ViewSettings,
    size: float,
    window: Window,
    shown: frozenset[str] = frozenset(),
) -> dict[str, str]:
    """The names to write, by frame: none over another, none out of sight.

    First the selected frame, then those that are stale, gone or in conflict, then those `shown`
    already, then the nearest.
    """
    rows = range(len(frames)) if settings.names else _selected(frames, settings.selected)
    if not rows:
        return {}
    at = np.array(rows, np.intp)
    pixels, depth_m = window.project(xyz[at] + (0.0, 0.0, _ABOVE * size))
    importance = np.array([_importance(frames[row], settings.selected, shown) for row in at])
    order = np.lexsort((depth_m, importance))
    order = order[window.sees(pixels, depth_m)[order]][:_CONSIDERED]
    written: list[_Written] = []
    for place in order:
        row = int(at[place])
        beside = next((one for one in written if _are_together(xyz, one.rows[0], row, size)), None)
        if beside is None and len(written) == MOST:
            continue
        rows_here = sorted([*beside.rows, row]) if beside else [row]
        pixel = beside.pixel if beside else pixels[place]
        box = _box(pixel, _text([frames[row] for row in rows_here]))
        if any(_overlap(box, one.box) for one in written if one is not beside):
            continue
        if beside:
            beside.rows.append(row)
            beside.box = box
        else:
            written.append(_Written([row], pixel, box))
    # Names in one label are in the order of the tree.
    return {
        frames[one.rows[0]].name: _text([frames[row] for row in sorted(one.rows)])
        for one in written
    }


@dataclass
class _Written:
    rows: list[int]
    pixel: Floats
    box: Floats


def _selected(frames: Sequence[ViewFrame], name: str) -> list[int]:
    return [row for row, frame in enumerate(frames) if frame.name == name]


def _importance(frame: ViewFrame, selected: str, shown: frozenset[str]) -> int:
    if frame.name == selected:
        return 0
    if frame.state in FAULTS:
        return 1
    return 2 if frame.name in shown else 3


def _are_together(xyz: Floats, one: int, other: int, size: float) -> bool:
    return bool(np.abs(xyz[one] - xyz[other]).max() < size * _TOGETHER)


def _text(frames: Sequence[ViewFrame]) -> str:
    names = [
        f"{_short(frame.name)} ({frame.state})" if frame.state in FAULTS else _short(frame.name)
        for frame in frames
    ]
    return listed(names, most=_MOST_TOGETHER)


def _short(name: str) -> str:
    if len(name) <= _LONGEST:
        return name
    return f"{name[: _LONGEST // 2 - 1]}…{name[-_LONGEST // 2 :]}"


def _box(pixel: Floats, text: str) -> Floats:
    """Left, top, right and bottom of a text that stands on a pixel."""
    half = (_LETTER * len(text) + _MARGIN) / 2.0
    return np.array([pixel[0] - half, pixel[1] - _HEIGHT, pixel[0] + half, pixel[1]])


def _overlap(one: Floats, other: Floats) -> bool:
    return bool(np.all(one[:2] < other[2:]) and np.all(other[:2] < one[2:]))
