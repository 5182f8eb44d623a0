"""Simulated hosts with their clocks, and the processes on them."""

import random
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from tfbus.testing.tasks import Task, Tasks

if TYPE_CHECKING:
    from tfbus.testing.zenoh_session import ZenohSession

# The time of all simulations at their start: 2026-01-01.
START_NS = 1_767_225_600 * 10**9


class Host:
    """A computer: a clock that may be wrong, and processes."""

    def __init__(
        self, tasks: Tasks, name: str, *, offset_s: float = 0.0, drift_ppm: float = 0.0
    ) -> None:
        self._tasks = tasks
        self.name = name
        # Endpoints name a host by its name, or by the address that it has now.
        self.address = name
        self.drift_ppm = drift_ppm
        self._offset_ns = round(offset_s * 1e9)
        self.processes: list[Process] = []

    def time_ns(self) -> int:
        """The time by its clock, in nanoseconds since the Unix epoch."""
        elapsed_ns = self._tasks.now_ns
        drift_ns = int(elapsed_ns * self.drift_ppm / 1e6)
        return START_NS + elapsed_ns + drift_ns + self._offset_ns

    def step_clock(self, step_s: float) -> None:
        """Set its clock forward, or back where the step is negative."""
        self._offset_ns += round(step_s * 1e9)

    def __repr__(self) -> str:
        return f"<Host {self.name}>"


class Process:
    """A process on a host, as `start` and `process` of the network make it."""

    def __init__(self, tasks: Tasks, host: Host, name: str, pid: int) -> None:
        self._tasks = tasks
        self.host = host
        self.name = f"{host.name}/{name}"
        self.pid = pid
        self.random = random.Random(tasks.random.random())
        self.is_stopped = False
        self.is_dead = False
        self.parked: list[Task] = []
        self.sessions: list[ZenohSession] = []
        # What has arrived while it was stopped.
        self._arrived: list[Callable[[], object]] = []
        self.main: Task | None = None
        # Starts it anew, where it has a main function.
        self.begin: Callable[[], Process] | None = None

    def receive(self, call: Callable[[], object]) -> None:
        """Do what the network brings, now or as soon as the process goes on."""
        if self.is_stopped:
            self._arrived.append(call)
        elif not self.is_dead:
            call()

    def go_on(self) -> None:
        """Run again after it was stopped."""
        self.is_stopped = False
        arrived, self._arrived = self._arrived, []
        for call in arrived:
            self.receive(call)
        self._tasks.unpark(self.parked)

    @property
    def is_running(self) -> bool:
        """Whether it is neither stopped nor dead."""
        return not (self.is_stopped or self.is_dead)

    def urandom(self, size: int) -> bytes:
        """Random bytes, which the seed decides."""
        return self.random.randbytes(size)

    def __repr__(self) -> str:
        return f"<Process {self.name}>"

    def __getstate__(self) -> Any:
        raise TypeError("a simulated process cannot be copied")
