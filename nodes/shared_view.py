"""How one robot's frames are shown to another: what there is to see, and what was sent of it."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

from tfbus import (
    Buffer,
    ExtrapolationException,
    Node,
    NodeSettings,
    StaticTransformBroadcaster,
    TransformBroadcaster,
    TransformException,
    TransformStamped,
)

# How the names of streams end that show frames of others.
SHARED = "/shared"


@dataclass(frozen=True)
class View:
    """A frame as it is seen now: its transform, and whether that holds at all times.

    Without a transform it is not to be seen; `reason` says why.
    """

    transform: TransformStamped | None
    static: bool = False
    reason: str = ""


def look(buffer: Buffer, relative_to: str, frame: str) -> View | None:
    """The view of a frame whose publishers are there; None while there is nothing new to say."""
    try:
        transform = buffer.lookup_transform(relative_to, frame, living=True)
        return View(transform, buffer.latest_common_time(relative_to, frame) is None)
    except ExtrapolationException:
        return None  # known, but between two samples
    except TransformException as reason:
        return View(None, reason=str(reason))


class Recipient:
    """A robot that frames are shown to: a node of its own in that robot's namespace.

    Raises InvalidNameError where no robot can have this name, BusError where the bus cannot be
    joined.
    """

    def __init__(self, settings: NodeSettings, robot: str) -> None:
        namespace = "/".join(filter(None, (settings.namespace, robot)))
        self._node = Node.from_settings(replace(settings, namespace=namespace, sim_time=False))
        stream = f"{self._node.name}{SHARED}"
        self._moving = TransformBroadcaster(self._node, stream=stream)
        self._fixed = StaticTransformBroadcaster(self._node, stream=stream)
        self._sent: dict[str, View] = {}

    def close(self) -> None:
        """Show nothing any more: the frames are gone for the robot."""
        self._node.close()

    def show(self, views: Mapping[str, View]) -> None:
        """Send what is new of the frames, and take back what is not to be seen any more."""
        news = {frame: view for frame, view in views.items() if self._sent.get(frame) != view}
        for frame, view in news.items():
            former = self._sent.pop(frame, None)
            if former is not None and (view.transform is None or view.static != former.static):
                (self._fixed if former.static else self._moving).remove(frame)
        seen = {frame: view for frame, view in news.items() if view.transform is not None}
        if moving := _transforms(view for view in seen.values() if not view.static):
            self._moving.send_transform(moving)
        if fixed := _transforms(view for view in seen.values() if view.static):
            self._fixed.send_transform(fixed)
        self._sent |= seen


def _transforms(views: Iterable[View]) -> list[TransformStamped]:
    return [view.transform for view in views if view.transform is not None]
