"""Paths between hosts, and the lanes of links over them: what is late, lost or in order.

On a link of TCP nothing is lost or overtakes: a lost packet delays all behind it. On one of UDP a
lost packet is lost, and Zenoh drops one that another has overtaken.
"""

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from tfbus.testing.tasks import Tasks

if TYPE_CHECKING:
    from tfbus.testing.processes import Host

# As tfbus sets it, and Linux.
LEASE_S = 1.5
_RESEND_AFTER_S = 0.2

# A queue of Zenoh's holds this much of urgent messages, and of others, before it drops them.
_URGENT_BYTES = 8 * 65536
_OTHER_BYTES = 2 * 65536


@dataclass
class Path:
    """The way from one host to another, in one direction.

    Seconds, bytes a second (0: without bound), and the shares of packets that are lost, and that
    take twice as long, so that others overtake them. `is_up` is whether anything arrives,
    `multicast` whether peers find each other by it.
    """

    delay_s: float = 0.0002
    jitter_s: float = 0.0001
    loss: float = 0.0
    reordering: float = 0.0
    bytes_a_second: float = 0.0
    multicast: bool = True
    is_up: bool = True
    changed_ns: int = 0

    def delays_s(self, chance: Callable[[], float]) -> tuple[float, float]:
        """How long one packet takes, and how much longer where others overtake it."""
        is_late = self.reordering and chance() < self.reordering
        more_s = self.delay_s + self.jitter_s if is_late else 0.0
        return self.delay_s + self.jitter_s * chance(), more_s


class Paths:
    """The paths between all hosts."""

    def __init__(self) -> None:
        self._paths: dict[tuple[Host, Host], Path] = {}

    def between(self, one: "Host", other: "Host") -> Path:
        """The path from one host to another, or to itself."""
        path = self._paths.get((one, other))
        if path is None:
            path = Path(0.00005, 0.00005) if one is other else Path()
            self._paths[one, other] = path
        return path

    def both_ways(self, one: "Host", other: "Host") -> Iterator[Path]:
        """The path from one host to another, and the path back."""
        yield self.between(one, other)
        yield self.between(other, one)


class Lane:
    """One direction of a link: calls that arrive at its far end, in their order.

    All of them where it `is_reliable`.
    """

    def __init__(self, tasks: Tasks, path: Path, *, is_reliable: bool = True) -> None:
        self._tasks = tasks
        self.path = path
        self.is_reliable = is_reliable
        self._arrived_ns = 0
        self._free_ns = 0
        # The numbers of packets, where they may overtake.
        self._number = self._arrived_number = 0
        # Calls that wait for the path to be up again, or for one before them, by their places in
        # the order; and the place of the next one to arrive.
        self._held: dict[int, tuple[Callable[[], object], int]] = {}
        self._places = itertools.count()
        self._next_place = 0
        self.is_open = True

    def backlog_bytes(self) -> float:
        """How much waits for the bandwidth, or for the path."""
        held = sum(size for _, size in self._held.values())
        waiting_ns = max(0, self._free_ns - self._tasks.now_ns)
        return held + waiting_ns / 1e9 * self.path.bytes_a_second

    def has_room(self, urgent: bool) -> bool:
        """Whether a message that may be dropped is sent."""
        return self.backlog_bytes() < (_URGENT_BYTES if urgent else _OTHER_BYTES)

    def send(self, call: Callable[[], object], size: int = 100) -> None:
        """Make a call at the far end, once it has arrived there."""
        if not self.is_reliable:
            self._launch_once(call, size)
        elif not self.path.is_up:
            self._held[next(self._places)] = call, size
        else:
            self._launch(next(self._places), call, size, 0.0)

    def release(self) -> None:
        """The path is up again: all that waits is sent anew, after TCP's pause."""
        held, self._held = sorted(self._held.items()), {}
        down_s = (self._tasks.now_ns - self.path.changed_ns) / 1e9
        pause_s = self._tasks.random.uniform(0, min(down_s, 2 * LEASE_S))
        for place, (call, size) in held:
            self._launch(place, call, size, pause_s)

    def _launch(self, place: int, call: Callable[[], object], size: int, pause_s: float) -> None:
        tasks, path = self._tasks, self.path
        chance = tasks.random.random
        late_s = pause_s + sum(path.delays_s(chance))
        resend_s = _RESEND_AFTER_S
        while path.loss and chance() < path.loss:
            late_s += resend_s
            resend_s = min(2 * resend_s, 60.0)
        sent_ns = self._sent_ns(size)
        self._arrived_ns = max(self._arrived_ns + 1, sent_ns + round(late_s * 1e9))

        def arrive() -> None:
            if not self.is_open:
                return
            # One that is lost on its way is sent again, and all that was sent after it waits.
            self._held[place] = call, size
            while self.path.is_up and self._next_place in self._held:
                next_call, _ = self._held.pop(self._next_place)
                self._next_place += 1
                next_call()

        tasks.call_at(self._arrived_ns, arrive)

    def _launch_once(self, call: Callable[[], object], size: int) -> None:
        """Send a packet that is lost where the path loses it, or where another overtakes it."""
        tasks, path = self._tasks, self.path
        chance = tasks.random.random
        if path.loss and chance() < path.loss:
            return
        delay_s, more_s = path.delays_s(chance)
        due_ns = self._sent_ns(size) + round(delay_s * 1e9)
        # Jitter alone changes no order: packets of one way wait in one queue.
        due_ns = self._arrived_ns = max(self._arrived_ns + 1, due_ns)
        due_ns += round(more_s * 1e9)
        self._number += 1
        number = self._number

        def arrive() -> None:
            if self.is_open and path.is_up and number > self._arrived_number:
                self._arrived_number = number
                call()

        tasks.call_at(due_ns, arrive)

    def _sent_ns(self, size: int) -> int:
        """When the last byte has left, by the bandwidth of the path."""
        sent_ns = self._tasks.now_ns
        if self.path.bytes_a_second:
            sent_ns = max(sent_ns, self._free_ns) + round(size / self.path.bytes_a_second * 1e9)
            self._free_ns = sent_ns
        return sent_ns
