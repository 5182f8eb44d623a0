"""Simulated hosts with their clocks, the processes on them, and the table of all."""

import random
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterator
from functools import partial
from typing import TYPE_CHECKING, Any, NoReturn, TypeVar

from tfbus.base.wording import did_you_mean
from tfbus.testing.primitives import Waiting
from tfbus.testing.tasks import SimulationError, Task, Tasks, task_of

if TYPE_CHECKING:
    from tfbus.testing.fabric import Fabric
    from tfbus.testing.programs import Program
    from tfbus.testing.zenoh_session import ZenohSession


T = TypeVar("T")

# The host of the test itself.
OUTSIDE = "outside"

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
        self.first_clock = offset_s, drift_ppm
        self._offset_ns = round(offset_s * 1e9)
        # The time in which it was suspended: its monotonic clock stood still.
        self.suspended_ns = 0
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
        # The messages that have arrived while it was stopped.
        self._arrived: list[Callable[[], object]] = []
        self.main: Task | None = None
        # Starts it anew, if it has a main function.
        self.begin: Callable[[], Process] | None = None
        # Its program, if that has arguments and output of its own.
        self.program: Program | None = None
        # Otherwise the `sys.argv` of a main function, without pytest's arguments.
        self.argv: list[str] = []
        self._argv_of_others: list[str] = []
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
        """A task of its own has the turn: the one `sys.argv` of Python is its own."""
        if self.program is not None:
            self.program.enter()
        elif self.argv:
            self._argv_of_others, sys.argv = sys.argv, self.argv

    def leave(self) -> None:
        """A task of another process has the turn."""
        if self.program is not None:
            self.program.leave()
        elif self.argv:
            self.argv, sys.argv = sys.argv, self._argv_of_others

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
        """Call the registered functions, the last first."""
        while self._at_exit:
            _, call = self._at_exit.pop()
            try:
                call()
            except Exception:
                traceback.print_exc()

    def receive(self, call: Callable[[], object]) -> None:
        """Call a callback of the network, now or as soon as the process goes on."""
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


# Signals that do nothing by default.
_IGNORED = {
    number
    for name in ("SIGCHLD", "SIGURG", "SIGWINCH")
    if (number := getattr(signal, name, None)) is not None
}


class ProcessTable:
    """All hosts and processes, and a kernel's work for them."""

    def __init__(self, tasks: Tasks, fabric: "Fabric") -> None:
        self.tasks = tasks
        self._fabric = fabric
        self.hosts: dict[str, Host] = {}
        self._pids = 1000

    # Hosts and processes

    def host(self, name: str) -> Host:
        """The host of this name. Raises SimulationError if there is none."""
        if name not in self.hosts:
            known = did_you_mean(name, {*self.hosts} - {OUTSIDE})
            raise SimulationError(
                f"the network has no host {name!r}: make it by network.host({name!r}){known}"
            )
        return self.hosts[name]

    def host_with_clock(self, name: str, offset_s: float, drift_ppm: float) -> Host:
        """The host of this name, made the first time. Raises SimulationError for a clock that it
        does not have.
        """
        if not isinstance(name, str) or not name or "/" in name:
            raise SimulationError(f"the name of a host is a text without a slash, not {name!r}")
        host = self.hosts.get(name)
        if host is None:
            host = self.hosts[name] = Host(self.tasks, name, offset_s=offset_s, drift_ppm=drift_ppm)
        elif (offset_s or drift_ppm) and (offset_s, drift_ppm) != host.first_clock:
            raise SimulationError(
                f"there is a host {name!r} already, with another clock: set that by "
                f"network.host({name!r}).step_clock(seconds)"
            )
        return host

    def process(self, name: str) -> Process:
        """The latest process of the name "host/process". Raises SimulationError without one."""
        for each in reversed([*self.processes()]):
            if each.name == name:
                return each
        names = {each.name for each in self.processes() if each.host.name != OUTSIDE}
        of_hosts = sorted(each for each in names if each.endswith(f"/{name}"))
        known = f"; did you mean {of_hosts[0]!r}?" if of_hosts else did_you_mean(name, names)
        raise SimulationError(f"the network has no process {name!r}{known}")

    def processes(self) -> Iterator[Process]:
        """All that there are or have been, host by host."""
        for host in self.hosts.values():
            yield from host.processes

    def current_process(self) -> Process:
        """The process whose turn it is."""
        process: Process = self.tasks.current.place
        return process

    # Its begin and end

    def add(self, host: Host, name: str) -> Process:
        """A new process, which does nothing yet."""
        self._pids += 1
        process = Process(self.tasks, host, name, self._pids)
        host.processes.append(process)
        return process

    def run(self, process: Process, main: Callable[[], object]) -> None:
        """Run `main()` on the main thread of a process, which ends with it."""

        def run() -> None:
            try:
                main()
            finally:
                if not self.tasks.is_over:
                    self.end(process)

        if process.program is None:
            process.argv = sys.argv[:1]
        with self.tasks.within(process):
            thread = threading.Thread(target=run, name="MainThread", daemon=False)
            thread.start()
        process.main = task_of(thread)

    def finish(self, process: Process) -> None:
        """The main function of a process has ended: wait for its threads, as Python does."""
        self.tasks.join_all(process)
        process.call_at_exit()

    def end(self, process: Process) -> None:
        """End a process at once: its host closes its sockets."""
        if not process.is_dead:
            self._check_other(process)
            process.is_dead = True
            process.ended.wake_all()
            self._fabric.process_ended(process)

    def vanish(self, process: Process) -> None:
        """End a process without a word to others."""
        if not process.is_dead:
            self._check_other(process)
            process.is_dead, process.exit_code = True, -signal.SIGKILL
            process.ended.wake_all()
            self._fabric.process_vanished(process)

    def forget_at_exit(self, call: Callable[..., object]) -> None:
        """As `atexit.unregister`, in whichever process it was registered."""
        for host in self.hosts.values():
            for process in host.processes:
                process.forget_at_exit(call)

    def exit_at_once(self, code: int) -> NoReturn:
        """As `os._exit`, in the process whose turn it is."""
        process = self.current_process()
        self.end(process)
        process.exit_code = code
        while True:
            self.tasks.wait("nothing")

    def _check_other(self, process: Process) -> None:
        if process is self.tasks.main.place:
            raise SimulationError(
                f"the calls of the test itself are in process {process.name!r}: it can be stopped, "
                "or end, after the `with` of network.process or network.within"
            )

    # Signals

    def signal(self, process: Process, number: int) -> None:
        """Send a signal to a process: its handler is called at the next turn of its main thread."""
        if number and number not in signal.valid_signals():
            raise SimulationError(f"there is no signal {number!r}: give one such as signal.SIGTERM")
        if process.is_dead or not number:
            return
        handler = process.handler(number)
        if number == signal.SIGSTOP:
            self.stop(process)
        elif number == signal.SIGCONT:
            self.go_on(process)
        elif number == signal.SIGKILL or handler == signal.SIG_DFL or process.main is None:
            if number not in _IGNORED:
                self.end(process)
                process.exit_code = -number
        elif handler != signal.SIG_IGN:
            self.tasks.interrupt(process.main, partial(handler, number, None))

    def signal_pid(self, pid: int, number: int) -> None:
        """As `os.kill`."""
        for host in self.hosts.values():
            for process in host.processes:
                if process.pid == pid and not process.is_dead:
                    self.signal(process, number)
                    return
        raise ProcessLookupError(f"no process {pid} in this simulation")

    def stop(self, process: Process) -> None:
        """As SIGSTOP."""
        self._check_other(process)
        process.is_stopped = True
        self._fabric.process_stopped(process)

    def go_on(self, process: Process) -> None:
        """As SIGCONT."""
        process.go_on()
        self._fabric.process_goes_on(process)
