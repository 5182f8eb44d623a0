"""The view of one robot's frames that another robot gets, and the part sent so far."""

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

# The end of the names of streams that show frames of others.
SHARED = "/shared"


@dataclass(frozen=True)
class View:
    """A frame as it is now: its transform, and whether that is static.

    Without a transform it is not visible; `reason` says why.
    """

    transform: TransformStamped | None
    static: bool = False
    reason: str = ""


def look(buffer: Buffer, relative_to: str, frame: str) -> View | None:
    """The view of a frame whose publishers run; None if there is nothing new."""
    try:
        transform = buffer.lookup_transform(relative_to, frame, living=True)
        return View(transform, buffer.latest_common_time(relative_to, frame) is None)
    except ExtrapolationException:
        return None  # known, but between two samples
    except TransformException as reason:
        return View(None, reason=str(reason))


class Recipient:
    """A robot that sees the frames: a node in that robot's namespace.

    Raises InvalidNameError for an invalid name, BusError if the bus cannot be joined.
    """

    def __init__(self, settings: NodeSettings, robot: str) -> None:
        namespace = "/".join(filter(None, (settings.namespace, robot)))
        self._node = Node.from_settings(replace(settings, namespace=namespace, sim_time=False))
        stream = f"{self._node.name}{SHARED}"
        self._dynamic = TransformBroadcaster(self._node, stream=stream)
        self._static = StaticTransformBroadcaster(self._node, stream=stream)
        self._sent: dict[str, View] = {}

    def close(self) -> None:
        """Stop: the frames are gone for the robot."""
        self._node.close()

    def show(self, views: Mapping[str, View]) -> None:
        """Send the views that changed, and remove frames that are no longer visible."""
        news = {frame: view for frame, view in views.items() if self._sent.get(frame) != view}
        for frame, view in news.items():
            former = self._sent.pop(frame, None)
            if former is not None and (view.transform is None or view.static != former.static):
                (self._static if former.static else self._dynamic).remove(frame)
        seen = {frame: view for frame, view in news.items() if view.transform is not None}
        if dynamic := _transforms(view for view in seen.values() if not view.static):
            self._dynamic.send_transform(dynamic)
        if static := _transforms(view for view in seen.values() if view.static):
            self._static.send_transform(static)
        self._sent |= seen


def _transforms(views: Iterable[View]) -> list[TransformStamped]:
    return [view.transform for view in views if view.transform is not None]
