"""ROS's tf2_ros.transform_listener."""

import threading
from contextlib import suppress
from typing import Any

from tfbus.base.arguments import called_as
from tfbus.compat.rclpy.exceptions import NotInitializedException
from tfbus.compat.rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from tfbus.compat.rclpy.node import Node, node_of_transforms, tfbus_node_of
from tfbus.compat.tf2_ros.buffer import Buffer
from tfbus.streams.listener import TransformListener as TfbusListener

__all__ = ["DEFAULT_STATIC_TF_TOPIC", "DEFAULT_TF_TOPIC", "TransformListener"]

DEFAULT_TF_TOPIC = "/tf"
DEFAULT_STATIC_TF_TOPIC = "/tf_static"


class TransformListener:
    """Fills a buffer with the transforms on the bus, on threads of its own: nothing to spin.

    `spin_thread=True` spins the node for its other callbacks, as in ROS. QoS is not applied, which
    is logged. `tfbus_listener` is the listener of tfbus underneath. The topics say whose transforms
    they are: `/tf` the transforms of the node's namespace, `/robot7/tf` robot7's. Raises TypeError
    for topics of other names.
    """

    @called_as("TransformListener(buffer, node)")
    def __init__(
        self,
        buffer: Buffer,
        node: Any,
        *,
        spin_thread: bool = False,
        qos: Any = None,
        static_qos: Any = None,
        tf_topic: str = "/tf",
        tf_static_topic: str = "/tf_static",
        static_only: bool = False,
    ) -> None:
        if static_only:
            raise TypeError("static_only: a listener of tfbus receives dynamic transforms too")
        self._check(buffer)
        self.node = node
        self._tfbus_node = node_of_transforms(node, tf_topic)
        if self._tfbus_node is not node_of_transforms(node, tf_static_topic):
            raise TypeError(
                f"tf_topic={tf_topic!r} and tf_static_topic={tf_static_topic!r} must be of one "
                "namespace: a listener of tfbus receives both kinds of transforms of one"
            )
        warn_of_qos(node, "TransformListener", qos, static_qos)
        self._buffer = buffer
        self._heard_before = 0
        self.tfbus_listener = self._listen(buffer)
        self._executor: SingleThreadedExecutor | None = None
        if isinstance(node, Node):
            node.work.listeners.append(self._count)
            if spin_thread:
                self._spin(node)

    @property
    def buffer(self) -> Buffer:
        """The buffer that it fills; set it to fill another buffer from then on."""
        return self._buffer

    @buffer.setter
    def buffer(self, buffer: Buffer) -> None:
        self._heard_before = self._count()
        self.tfbus_listener.close()
        self._buffer = buffer
        self.tfbus_listener = self._listen(buffer)

    def unregister(self) -> None:
        """Stop listening; the buffer keeps its transforms. Twice is fine."""
        if self._executor is not None:
            self._executor.shutdown()
        if isinstance(self.node, Node):
            with suppress(ValueError):  # it is unregistered already
                self.node.work.listeners.remove(self._count)
        self.tfbus_listener.close()

    @staticmethod
    def _check(buffer: Any) -> None:
        if not isinstance(buffer, Buffer):
            raise TypeError(
                "a TransformListener takes a Buffer of tfbus.compat.tf2_ros and a node, in this "
                f"order: TransformListener(buffer, node), not a {type(buffer).__name__}"
            )

    def _listen(self, buffer: Buffer) -> TfbusListener:
        self._check(buffer)
        buffer.run_callbacks_in(self.node)
        return TfbusListener(buffer.tfbus_buffer, self._tfbus_node)

    def _count(self) -> int:
        """How many messages came."""
        return self._heard_before + sum(stream.messages for stream in self.tfbus_listener.streams())

    def _spin(self, node: Node) -> None:
        executor = self._executor = SingleThreadedExecutor()
        executor.add_node(node)
        threading.Thread(target=_spin, args=(executor,), name="spin_thread", daemon=True).start()


def warn_of_qos(node: Any, what: str, *profiles: Any) -> None:
    """Log once that transforms are sent as they are, if a QoS was given."""
    if any(profile is not None for profile in profiles):
        log = tfbus_node_of(node).log
        log.warning(
            "The QoS of the %s is not applied: tfbus sends all transforms reliably, and keeps "
            "static ones for those that come later",
            what,
        )


def _spin(executor: SingleThreadedExecutor) -> None:
    with suppress(ExternalShutdownException, KeyboardInterrupt, NotInitializedException):
        executor.spin()
