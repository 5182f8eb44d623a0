"""Simulated hosts with their clocks, and the processes on them."""

import random
import signal
import traceback
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any, TypeVar

from tfbus.testing.primitives import Waiting
from tfbus.testing.tasks import Task, Tasks

if TYPE_CHECKING:
    from tfbus.testing.programs import Program
    from tfbus.testing.zenoh_session import ZenohSession

T = TypeVar("T")

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
        self._read_ns = 0
        self.processes: list[Process] = []

    def time_ns(self) -> int:
        """The time by its clock, in nanoseconds since the Unix epoch."""
        elapsed_ns = self._tasks.now_ns
        drift_ns = int(elapsed_ns * self.drift_ppm / 1e6)
        now_ns = START_NS + elapsed_ns + drift_ns + self._offset_ns
        # No two readings are the same, though no time passes while a task runs.
        self._read_ns = max(now_ns, self._read_ns + 1)
        return self._read_ns

    def step_clock(self, step_s: float) -> None:
        """Set its clock forward, or back if the step is negative."""
        self._offset_ns += round(step_s * 1e9)
        self._read_ns = 0

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
        # What it runs, where that is a program with arguments and output of its own.
        self.program: Program | None = None
        # By its number for a signal that ended it; None while it runs, or where that is unknown.
        self.exit_code: int | None = None
        self.ended = Waiting(tasks)
        self._handlers: dict[int, Any] = {signal.SIGINT: signal.default_int_handler}
        self._at_exit: list[tuple[Callable[..., object], Callable[[], object]]] = []
        self._objects: dict[type, Any] = {}

    def object_of(self, kind: type[T]) -> T:
        """The one object of this class that it has, made the first time."""
        if kind not in self._objects:
            self._objects[kind] = kind()
        found: T = self._objects[kind]
        return found

    def enter(self) -> None:
        """One of its tasks has the turn: what Python has once is that of this process."""
        if self.program is not None:
            self.program.enter()

    def leave(self) -> None:
        """A task of another process has the turn."""
        if self.program is not None:
            self.program.leave()

    # Signals, and its end

    def handler(self, number: int) -> Any:
        """As `signal.getsignal`."""
        return self._handlers.get(number, signal.SIG_DFL)

    def set_handler(self, number: int, handler: Any) -> Any:
        """As `signal.signal`."""
        former, self._handlers[number] = self.handler(number), handler
        return former

    def at_exit(self, call: Callable[..., Any], *args: Any, **named: Any) -> Callable[..., Any]:
        """As `atexit.register`."""
        self._at_exit.append((call, partial(call, *args, **named)))
        return call

    def forget_at_exit(self, call: Callable[..., object]) -> None:
        """As `atexit.unregister`."""
        self._at_exit = [each for each in self._at_exit if each[0] != call]

    def call_at_exit(self) -> None:
        """Call what is registered, the last first."""
        while self._at_exit:
            _, call = self._at_exit.pop()
            try:
                call()
            except Exception:
                traceback.print_exc()

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
