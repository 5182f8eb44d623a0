"""ROS's tf2_ros.buffer: lookups, with waiting in threads, callbacks, coroutines and asyncio."""

import asyncio
from collections.abc import Callable, Coroutine
from concurrent.futures import Future as Ended
from functools import partial
from typing import Any

from tfbus.base import scheduler
from tfbus.base.errors import TransformException
from tfbus.compat.rclpy.duration import Duration, seconds_of
from tfbus.compat.rclpy.node import Node, tfbus_node_of
from tfbus.compat.rclpy.task import Future, Run
from tfbus.compat.tf2_py import BufferCore, in_ros_words
from tfbus.compat.tf2_ros.buffer_interface import BufferInterface
from tfbus.ros.transforms import message_of, stamp_ns_of

__all__ = ["Buffer"]

# It never changes.
_AT_ONCE = Duration()


class Buffer(BufferCore, BufferInterface):
    """The transforms of the last `cache_time`, by default 10 s, filled by a TransformListener.

    Safe from any thread. A lookup may wait anywhere, in callbacks too. `tfbus_buffer` is the
    `tfbus.Buffer` underneath. With a `node` its clock decides how long waits are; the service
    `tf2_frames` is not there, as `tfbus frames` needs none.
    """

    def __init__(self, cache_time: Duration | None = None, node: Any = None, **unknown: Any):
        if unknown:
            raise TypeError(
                f"a Buffer of tfbus.compat does not take {', '.join(unknown)}: its arguments are "
                "cache_time and node"
            )
        BufferCore.__init__(self, cache_time)
        BufferInterface.__init__(self)
        self._run: Run | None = None
        if node is not None:
            self._buffer.clock = tfbus_node_of(node).clock
            self.run_callbacks_in(node)

    def run_callbacks_in(self, node: Any) -> None:
        """Run the callbacks of futures while this node is spun; its listener calls this."""
        if isinstance(node, Node):
            self._run = node.work.submit

    def lookup_transform(
        self, target_frame: str, source_frame: str, time: Any, timeout: Any = _AT_ONCE
    ) -> Any:
        """The transform that takes data in the source frame into the target frame, at that time.

        The time is a Time or a message's stamp, 0 the latest. Waits at most `timeout`. Raises
        LookupException, ConnectivityException, ExtrapolationException or InvalidArgumentException,
        after waiting too, and at once if waiting does not help.
        """
        timeout_s = 0.0 if timeout is _AT_ONCE else _seconds(timeout)
        return self._look_up(target_frame, source_frame, time, timeout_s)

    def lookup_transform_full(
        self, target_frame: str, target_time: Any, source_frame: str, source_time: Any,
        fixed_frame: str, timeout: Any = _AT_ONCE,
    ) -> Any:  # fmt: skip
        """The source as it was at one time, seen from the target at another, by way of a frame that
        does not move between the two.
        """
        return self._look_up_full(
            target_frame, target_time, source_frame, source_time, fixed_frame, _seconds(timeout)
        )

    def can_transform(
        self, target_frame: str, source_frame: str, time: Any, timeout: Any = _AT_ONCE,
        return_debug_tuple: bool = False,
    ) -> Any:  # fmt: skip
        """Whether it can be looked up; with `return_debug_tuple` also why not."""
        answer = self._can(target_frame, source_frame, time, _seconds(timeout))
        return answer if return_debug_tuple else answer[0]

    def can_transform_full(
        self, target_frame: str, target_time: Any, source_frame: str, source_time: Any,
        fixed_frame: str, timeout: Any = _AT_ONCE, return_debug_tuple: bool = False,
    ) -> Any:  # fmt: skip
        """Whether it can be looked up; with `return_debug_tuple` also why not."""
        answer = self._can_full(
            target_frame, target_time, source_frame, source_time, fixed_frame, _seconds(timeout)
        )
        return answer if return_debug_tuple else answer[0]

    def wait_for_transform_async(self, target_frame: str, source_frame: str, time: Any) -> Future:
        """A future of the transform, for callbacks, coroutines and asyncio.

        It waits for ever, unless cancelled; if waiting does not help it has the exception.
        """
        stamp_ns = stamp_ns_of(time) or None
        look = partial(self.lookup_transform_core, target_frame, source_frame, time)
        wait = partial(self._buffer.wait_for_transform, target_frame, source_frame, stamp_ns)
        return TransformFuture(look, wait, self._run)

    def wait_for_transform_full_async(
        self, target_frame: str, target_time: Any, source_frame: str, source_time: Any,
        fixed_frame: str,
    ) -> Future:  # fmt: skip
        """The same through a fixed frame."""
        frames = (target_frame, target_time, source_frame, source_time, fixed_frame)
        look = partial(self.lookup_transform_full_core, *frames)
        wait = partial(
            self._buffer.wait_for_transform_full,
            target_frame,
            stamp_ns_of(target_time, "target_time") or None,
            source_frame,
            stamp_ns_of(source_time, "source_time") or None,
            fixed_frame,
        )
        return TransformFuture(look, wait, self._run)

    async def lookup_transform_async(self, target_frame: str, source_frame: str, time: Any) -> Any:
        """The transform as soon as there is one: `await` it in a callback, or in asyncio."""
        found = await self.wait_for_transform_async(target_frame, source_frame, time)
        return found

    async def lookup_transform_full_async(
        self, target_frame: str, target_time: Any, source_frame: str, source_time: Any,
        fixed_frame: str,
    ) -> Any:  # fmt: skip
        """The same through a fixed frame."""
        found = await self.wait_for_transform_full_async(
            target_frame, target_time, source_frame, source_time, fixed_frame
        )
        return found


class TransformFuture(Future):
    """A transform that is waited for, on a thread that all futures share."""

    def __init__(
        self,
        look: Callable[[], Any],
        wait: Callable[[], Coroutine[Any, Any, Any]],
        run: Run | None,
    ) -> None:
        if run is None:
            super().__init__()
        else:
            super().__init__(run=run)
        self._look = look
        if not self._is_there():
            loop = scheduler.of_process(_FuturesThread).loop
            waiting = asyncio.run_coroutine_threadsafe(self._wait(wait), loop)
            self.when_ended(partial(_cancel, waiting))

    def done(self) -> bool:
        """Whether it has a result or an exception, or was cancelled; looks, too."""
        return super().done() or self._is_there()

    def _is_there(self) -> bool:
        try:
            self.set_result(self._look())
        except TransformException:
            return False
        return True

    async def _wait(self, wait: Callable[[], Coroutine[Any, Any, Any]]) -> None:
        try:
            self.set_result(message_of(await wait()))
        except TransformException as error:
            self.set_exception(in_ros_words(error))


def _cancel(waiting: "Ended[None]") -> None:
    waiting.cancel()


class _FuturesThread:
    """The thread on which all futures of a process wait."""

    def __init__(self) -> None:
        self.loop = scheduler.new_event_loop()
        run = self.loop.run_forever
        scheduler.Thread(target=run, name="tf2 futures", daemon=True).start()


def _seconds(timeout: Any) -> float:
    return max(0.0, seconds_of(timeout))
