"""The channels /tf and /tf_static: transforms as ROS 2 and recordings have them.

Foxglove knows tf2_msgs/msg/TFMessage as well as a schema of its own. With this one a layout made
for the live bus shows a recording too, and both come from one encoder.
"""

import threading
from collections.abc import Callable
from contextlib import suppress

from tfbus.buffer.buffer import Buffer
from tfbus.errors import InvalidArgumentException, TransformException
from tfbus.foxglove.server import Server
from tfbus.geometry.columns import Columns
from tfbus.geometry.transform import TransformStamped
from tfbus.ros.definitions import TF_MESSAGE
from tfbus.ros.tf_message import TFMessageWriter
from tfbus.runtime.log_once import LogOnce


class TransformChannels:
    """Sends transforms to the clients that subscribe; safe from any thread."""

    def __init__(self, server: Server, now_ns: Callable[[], int], once: LogOnce) -> None:
        schema = TF_MESSAGE.name, "ros2msg", TF_MESSAGE.text.encode()
        self._dynamic = server.open_channel("/tf", "cdr", schema)
        self._static = server.open_channel("/tf_static", "cdr", schema)
        self._now_ns = now_ns
        self._once = once
        self._writer = TFMessageWriter()
        self._lock = threading.Lock()

    def have(self, channel_id: int) -> bool:
        """Whether a channel is one of these."""
        return channel_id in (self._dynamic.id, self._static.id)

    def send_present(self, buffer: Buffer, log_ns: int | None = None) -> None:
        """Send where all frames of a buffer are, for clients that come late."""
        for static in (True, False):
            self.send(present(buffer, static=static), static=static, log_ns=log_ns)

    def send(self, rows: Columns, *, static: bool, log_ns: int | None = None) -> None:
        """Send transforms, if a client subscribes."""
        channel = self._static if static else self._dynamic
        if not rows.count or not channel.is_watched:
            return
        try:
            with self._lock:
                message = self._writer.write(rows)
        except InvalidArgumentException as error:
            self._once.warning("transforms", "Foxglove cannot show some transforms: %s", error)
            return
        channel.send(message, self._now_ns() if log_ns is None else log_ns)


def present(buffer: Buffer, *, static: bool) -> Columns:
    """The static transforms of a buffer, or the last of each dynamic frame."""
    found = []
    for frame in buffer.all_frames():
        if frame.parent is None or frame.newest_ns is None or frame.static is not static:
            continue
        with suppress(TransformException):  # removed in between
            pose = buffer.lookup_transform(frame.parent, frame.name).transform
            found.append(TransformStamped(frame.newest_ns, frame.parent, frame.name, pose))
    return Columns.of_transforms(found)
