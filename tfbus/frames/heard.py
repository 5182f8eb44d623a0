"""The facts that tools for frames need: from a live listener, or from a recording."""

from typing import Protocol

from tfbus.buffer.buffer import Buffer
from tfbus.frames.snapshot import FrameTree


class Heard(Protocol):
    """The frames at one moment: the present of a bus, or any moment of a recording."""

    @property
    def buffer(self) -> Buffer:
        """The samples of the last seconds."""

    @property
    def dropped(self) -> int:
        """How many messages were dropped, since transforms came on too many keys."""

    def now_ns(self) -> int:
        """The moment, by the clock that the stamps are compared with."""

    def tree(self) -> FrameTree:
        """The tree of frames."""

    def hint(self, frame: str = "") -> str:
        """The place of a frame, or of any frame; "" if that is not known."""
