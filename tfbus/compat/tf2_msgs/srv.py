"""ROS's tf2_msgs.srv."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from tfbus.compat.missing import missing_messages

__all__ = ["FrameGraph"]

if not TYPE_CHECKING:  # type checkers find what is missing themselves
    __getattr__ = missing_messages(__name__)


class FrameGraph:
    """The tree of frames as text. A Buffer does not serve it: `tfbus frames` shows the tree, and
    `all_frames_as_yaml()` has the text.
    """

    @dataclass(slots=True, kw_only=True)
    class Request:
        """No values."""

    @dataclass(slots=True, kw_only=True)
    class Response:
        """What `all_frames_as_yaml()` returns."""

        frame_yaml: str = ""
