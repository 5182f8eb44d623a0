"""The turtles as a guest on the page of `tfbus view`: their tab, and their field in the scene."""

from collections.abc import Callable, Collection

import viser

from tfbus import Node
from tfbus.view.frames import Placed
from tfbus.view.panels.markup import Channel
from tfbus.view.scene.drawn import Region

from .panel import SCRIPT, STYLE, TurtlePanel
from .scene import WORLD, TurtleScene
from .turtles import Turtles


class TurtleGuest:
    """A tab that drives the turtles of the simulator on this bus, and their field."""

    title = "Turtles"
    style = STYLE
    script = SCRIPT

    def __init__(self, node: Node) -> None:
        self._node = node

    def join(self, scene: viser.SceneApi, is_watched: Callable[[], bool]) -> None:
        """Add the field, and look for a simulator."""
        self._turtles = Turtles(self._node, is_watched)
        self._scene = TurtleScene(scene, self._turtles)

    @property
    def is_present(self) -> bool:
        """Whether a simulator is on the bus and has answered."""
        return self._turtles.are_known

    def add_controls(self, gui: viser.GuiApi, channel: Channel) -> None:
        """Add the controls of the turtles."""
        self._panel = TurtlePanel(gui, self._turtles, channel)

    def refresh(self) -> None:
        """Bring the controls up to date."""
        self._panel.refresh()

    def draw(self, placed: Placed, fixed_frame: str) -> None:
        """Move the field and the turtles to where their frames are."""
        self._scene.draw(placed, fixed_frame)

    @property
    def frames(self) -> Collection[str]:
        """The frames of the field and of the turtles."""
        return (WORLD, *self._turtles.names)

    @property
    def region(self) -> Region | None:
        """The field; None while there is no simulator."""
        return self._scene.region
