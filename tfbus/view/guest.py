"""Additions of another program to the page: a tab of the panel, and shapes in the scene."""

from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import viser
from numpy.typing import NDArray

from tfbus.view.frames import Placed
from tfbus.view.panels.markup import Channel

# The node of viser's scene that all is drawn below: it has the axes of the fixed frame.
FIXED_NODE = "/fixed"


@dataclass(frozen=True, eq=False)
class Region:
    """A ball of the scene that is worth seeing whole: `middle` (3,) and radius in metres.

    `toward` (3,) points to where it is first seen from, None for from behind and above.
    """

    middle: NDArray[np.float64]
    radius_m: float
    toward: NDArray[np.float64] | None = None


class Guest(Protocol):
    """A tab with controls, and shapes in the scene.

    `title` is the name of the tab; `style` and `script` are CSS and JavaScript for its controls.
    The page calls `join` once, and then `draw` again and again, on one thread. The tab is there
    while `is_present`, but never on a page that is read-only: the page calls `add_controls` each
    time it appears, and then `refresh`.
    """

    title: str
    style: str
    script: str

    def join(self, scene: viser.SceneApi, is_watched: Callable[[], bool]) -> None:
        """Add the shapes, below FIXED_NODE; `is_watched` is for any thread."""

    @property
    def is_present(self) -> bool:
        """Whether the tab is of any use now."""

    def add_controls(self, gui: viser.GuiApi, channel: Channel) -> None:
        """Add the controls, inside a new tab; those of a former tab are gone."""

    def refresh(self) -> None:
        """Bring the controls up to date."""

    def draw(self, placed: Placed, fixed_frame: str) -> None:
        """Move the shapes to where the frames are."""

    @property
    def frames(self) -> Collection[str]:
        """The frames to place even if their axes are hidden."""

    @property
    def region(self) -> Region | None:
        """The first target of a browser's camera; None while the guest shows nothing."""
