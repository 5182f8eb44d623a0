"""ROS's package rclpy, as far as programs with tf2_ros need it, over a node of tfbus."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from tfbus.compat.modules import missing_names
from tfbus.compat.rclpy import (
    callback_groups,
    clock,
    constants,
    context,
    duration,
    exceptions,
    executors,
    logging,
    node,
    parameter,
    qos,
    task,
    time,
    utilities,
)

__all__ = [
    "Parameter",
    "callback_groups",
    "clock",
    "constants",
    "create_node",
    "duration",
    "exceptions",
    "executors",
    "get_default_context",
    "init",
    "logging",
    "node",
    "ok",
    "parameter",
    "qos",
    "shutdown",
    "spin",
    "spin_once",
    "spin_until_future_complete",
    "task",
    "time",
    "try_shutdown",
    "utilities",
]

# Names of rclpy that are not here, and their substitutes.
_INSTEAD = {
    "get_global_executor": "rclpy.executors.SingleThreadedExecutor()",
}

Parameter = parameter.Parameter
get_default_context = context.current

if not TYPE_CHECKING:  # type checkers find missing names themselves
    __getattr__ = missing_names(__name__, _INSTEAD, "node.tfbus_node is a tfbus.Node")


def init(
    *,
    args: Sequence[str] | None = None,
    signal_handler_options: Any = None,
    domain_id: int | None = None,
    **unknown: Any,
) -> context.Context:
    """Begin; of the arguments of the process, or `args`, all after `--ros-args` count. The bus has
    no domains.

    The context that it returns ends with a `with`, too. Raises RuntimeError if it was called
    before.
    """
    if unknown:
        raise TypeError(f"rclpy.init of tfbus.compat does not take {', '.join(unknown)}")
    return context.begin(args)


def ok(**_: Any) -> bool:
    """Whether to go on: False before `init`, and after `shutdown`, Ctrl-C and SIGTERM."""
    return context.is_ok()


def shutdown(**_: Any) -> None:
    """End all nodes; twice is fine."""
    context.end()


try_shutdown = shutdown


def create_node(node_name: str, **given: Any) -> node.Node:
    """A node, as `Node(node_name, ...)`."""
    return node.Node(node_name, **given)


def spin(node: node.Node, executor: executors.Executor | None = None) -> None:
    """Run the callbacks of the node until Ctrl-C or SIGTERM, which raise KeyboardInterrupt."""
    _with(node, executor).spin()


def spin_once(
    node: node.Node,
    *,
    executor: executors.Executor | None = None,
    timeout_sec: float | None = None,
) -> None:
    """Run one callback, if one is ready within that time (None: for ever).

    Of a node with a TransformListener it returns without one once transforms have come.
    """
    _with(node, executor).spin_once(timeout_sec)


def spin_until_future_complete(
    node: node.Node,
    future: task.Future,
    executor: executors.Executor | None = None,
    timeout_sec: float | None = None,
) -> None:
    """Run callbacks until the future has ended, at most `timeout_sec` s (None: for ever)."""
    _with(node, executor).spin_until_future_complete(future, timeout_sec)


def _with(node: node.Node, executor: executors.Executor | None) -> executors.Executor:
    executor = executor or executors.SingleThreadedExecutor()
    executor.add_node(node)
    return executor
