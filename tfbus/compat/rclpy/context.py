"""A context, from `rclpy.init` to `rclpy.shutdown`: the nodes of this process."""

import atexit
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING

from tfbus.base import scheduler
from tfbus.base.signals import StopSignals
from tfbus.compat.rclpy.exceptions import NotInitializedException

if TYPE_CHECKING:
    from tfbus.compat.rclpy.node import Node

__all__ = ["Context"]

_BEGIN, _END = "--ros-args", "--"

# The options that `tfbus launch` passes to a node, and how many arguments each takes up.
_OF_LAUNCH = {
    **dict.fromkeys(("--name", "--namespace", "--mode", "--connect", "--config", "--secure"), 2),
    **dict.fromkeys(("--log-level", "--param", "--remap"), 2),
    "--sim-time": 1,
}


class Context:
    """From `rclpy.init()` to `rclpy.shutdown()`, or the end of its `with`."""

    def __init__(self, args: Sequence[str]) -> None:
        self.node_arguments = split_arguments(args)[1]
        self.signals = StopSignals()
        self.nodes: list[Node] = []
        self.is_shut_down = False

    def ok(self) -> bool:
        """Whether to go on: False after `shutdown()`, Ctrl-C and SIGTERM."""
        return not self.is_shut_down and not self.signals.stopped

    def shutdown(self) -> None:
        """End all nodes, and `spin` in other threads; twice is fine."""
        if not self.is_shut_down:
            self.is_shut_down = True
            for node in list(self.nodes):
                node.destroy_node()
            self.signals.stop()
            self.signals.uninstall()

    try_shutdown = shutdown

    def __enter__(self) -> "Context":
        return self

    def __exit__(self, *_: object) -> None:
        self.shutdown()


class _Begun:
    """The context that this process began last."""

    context: Context | None = None


def begin(args: Sequence[str] | None) -> Context:
    """Begin, with the arguments of the process unless others are given."""
    begun = scheduler.of_process(_Begun)
    if begun.context is not None and not begun.context.is_shut_down:
        raise RuntimeError("rclpy.init() was called twice: call it once a process")
    begun.context = Context(sys.argv[1:] if args is None else args)
    atexit.register(begun.context.shutdown)
    return begun.context


def current() -> Context:
    """The context that is in force. Raises NotInitializedException if there is none."""
    context = scheduler.of_process(_Begun).context
    if context is None or context.is_shut_down:
        raise NotInitializedException("call rclpy.init() first")
    return context


def is_ok() -> bool:
    """Whether a context is in force, and not ended by a signal."""
    context = scheduler.of_process(_Begun).context
    return context is not None and context.ok()


def end() -> None:
    """End the context that is in force, if there is one."""
    context = scheduler.of_process(_Begun).context
    if context is not None:
        context.shutdown()


def split_arguments(args: Sequence[str]) -> tuple[list[str], list[str]]:
    """The arguments of the program, and its nodes' arguments: from --ros-args to -- or the end, and
    the options that `tfbus launch` puts before all others, which begin with --name.
    """
    own: list[str] = []
    of_nodes: list[str] = []
    rest = list(args)
    if rest and not rest[0].startswith("-"):  # the program, as in sys.argv
        own.append(rest.pop(0))
    if rest[:1] == ["--name"]:
        while rest and rest[0] in _OF_LAUNCH:
            of_nodes += rest[: _OF_LAUNCH[rest[0]]]
            del rest[: _OF_LAUNCH[rest[0]]]
    is_ros = False
    for arg in rest:
        if arg == _BEGIN:
            is_ros = True
        (of_nodes if is_ros else own).append(arg)
        if arg == _END:
            is_ros = False
    return own, of_nodes
