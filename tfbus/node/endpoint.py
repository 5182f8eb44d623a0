"""The common part of topics, services and actions of a node: checks, a name, a type, an end, and
the lane on whose thread its callbacks run.
"""

import logging
from collections.abc import Callable
from functools import partial
from typing import Any, Protocol

from tfbus.base.arguments import is_async, shown
from tfbus.base.callbacks import CallbackGroup, Delays, Failures, join
from tfbus.base.clock import Clock, SimulatedClock, Timer
from tfbus.base.executor import Executor
from tfbus.wire.codec import is_message_type, type_name


class Closable(Protocol):
    """A declaration of the session."""

    def close(self) -> None:
        """End it; twice is fine."""


class NodeEndpoint:
    """An end of a topic, service or action; it ends with its node, or by `close()` before.

    `type_` is a message class, or its name if the endpoint handles bytes only. `retained` says
    of a publisher whether its last message also reaches subscribers that join later. `definition`
    is the type's in ROS, if it has one that others cannot know.
    """

    def __init__(
        self, name: str, type_: type | str, *, retained: bool = False, definition: str = ""
    ) -> None:
        self.name = name
        self.definition = definition
        self.retained = retained
        self.type_name = type_ if isinstance(type_, str) else type_name(type_)
        self.closed = False
        self._parts: list[Closable] = []

    def close(self) -> None:
        """End it: it sends, receives and serves nothing after that. Twice is fine."""
        self.closed = True
        while self._parts:
            self._parts.pop().close()


def check_message_type(call: str, message_type: object) -> None:
    """Raise TypeError if it is no dataclass; `call` is the call as it should be."""
    if not is_message_type(message_type):
        raise TypeError(
            f"{call}: message_type must be a class of messages, a dataclass such as "
            f"tfbus.messages.Pose, not {shown(message_type)}"
        )


def check_parts(call: str, type_: object, parts: tuple[str, ...]) -> None:
    """Raise TypeError if it is no class that holds these dataclasses: a type of service or
    action.
    """
    missing = [part for part in parts if not is_message_type(getattr(type_, part, None))]
    if missing or not isinstance(type_, type):
        raise TypeError(
            f"{call}: the type must be a class that holds the dataclasses {' and '.join(parts)}, "
            f"not {shown(type_)}"
        )


def check_seconds(call: str, seconds: object) -> None:
    """Raise TypeError if it is no number."""
    if isinstance(seconds, str) or not hasattr(seconds, "__float__"):
        raise TypeError(f"{call}: the first argument must be a number, not {shown(seconds)}")


def check_part(what: str, part: Any, message: object) -> None:
    """Raise TypeError if the message is not of the type that the service or action takes."""
    if not isinstance(message, part):
        raise TypeError(f"{what} takes {part.__qualname__}, not {shown(message)}")


# At most so many callbacks of a node's groups run at once, unless it asks for more or fewer.
CALLBACK_THREADS = 8
MOST_CALLBACK_THREADS = 1000


class Lane:
    """The callbacks of one group, on the threads of an executor.

    `submit(what, callback, limit=None)` is the executor's, for the group.
    """

    def __init__(self, executor: Executor, group: CallbackGroup | None = None) -> None:
        self._executor = executor
        self._group = group
        # Called for each message: nothing is added for the node's own group.
        self.submit: Callable[..., bool] = (
            executor.submit if group is None else partial(executor.submit, group=group)
        )

    def dropped(self, what: str, pending: int) -> None:
        """Note that a topic of this name dropped a message, as so many wait already."""
        self._executor.dropped(what, pending)

    def every(self, clock: Clock, period_s: float, callback: Callable[[], Any]) -> Timer:
        """Run `callback` every `period_s` seconds of the clock."""
        if isinstance(clock, SimulatedClock):
            return self._executor.every_simulated(clock, period_s, callback, group=self._group)
        return self._executor.every(period_s, callback, group=self._group)


class Lanes:
    """The threads of a node's callbacks: `own`, of callbacks without a group, and at most
    `threads` further ones, which all its groups share. Each starts when it is first needed.
    """

    def __init__(self, name: str, log: logging.Logger, threads: int) -> None:
        if type(threads) is not int or not 1 <= threads <= MOST_CALLBACK_THREADS:
            raise ValueError(
                f"callback_threads must be an int of 1 to {MOST_CALLBACK_THREADS}, not {threads!r}"
            )
        self.delays, self.failures = Delays(log), Failures()
        self.own = Executor(name, log, delays=self.delays, failures=self.failures)
        self._name = name
        self._beside = Executor(
            f"{name} groups",
            log,
            threads=threads,
            home=self.own,
            delays=self.delays,
            failures=self.failures,
        )

    def lane(self, call: str, group: object, callback: object = None) -> Lane:
        """The lane of a group, None for the node's own; `call` is the call that was given it.

        Raises TypeError if it is no group, or the callback is an `async def`, which has none;
        ValueError if it is of another node.
        """
        if group is None:
            return Lane(self.own)
        if not isinstance(group, CallbackGroup):
            raise TypeError(
                f"{call}: callback_group must be a tfbus.MutuallyExclusiveCallbackGroup or a "
                f"tfbus.ReentrantCallbackGroup, an object that its callbacks share, not "
                f"{group!r:.60}"
            )
        if is_async(callback):
            raise TypeError(
                f"{call}: an async def has no callback_group: it runs on the node's own thread, "
                "and others run there while it awaits; leave callback_group out"
            )
        join(group, self._name)
        return Lane(self._beside, group)

    def describe(self) -> dict[str, list[Any]]:
        """The delays and failures in the node's description of itself, if there are some."""
        delays, failures = self.delays.described(self.own.overdue()), self.failures.described()
        return {
            **({"delays": delays} if delays else {}),
            **({"failures": failures} if failures else {}),
        }

    def close(self) -> None:
        """Run no further callbacks; the current ones have 2 s to finish."""
        self._beside.end()
        self.own.close()
        self._beside.close()
