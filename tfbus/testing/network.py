"""A simulated network: hosts, the paths between them, their processes, and the faults.

The real code runs on it, in virtual time, one task at a time. The same seed gives the same run.
"""

import gc
import inspect
import math
import os
import signal
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from functools import partial
from numbers import Real
from types import TracebackType
from typing import Any

from tfbus.base import scheduler
from tfbus.base.arguments import called_as
from tfbus.bus import zenoh_library
from tfbus.testing.fabric import Fabric, Faults
from tfbus.testing.links import Paths
from tfbus.testing.of_python import random_numbers_of, standing_in
from tfbus.testing.primitives import scheduler_names
from tfbus.testing.processes import OUTSIDE, START_NS, Host, Process, ProcessTable
from tfbus.testing.programs import Program, main_of_command, module_of
from tfbus.testing.tasks import SimulationError, Task, Tasks, on_one_cpu

# How often a condition is looked at while the network runs.
_LOOK_EVERY_S = 0.005

_IN_FORCE = "the network is in force within its `with`: with Network() as network"


class Network:
    """A simulated network, in force until the end of its `with`: hosts, and all that runs on them.

        with Network(seed=1) as network:
            robot, base = network.host("robot"), network.host("base")
            network.path(robot, base, delay_s=0.02, loss=0.05)
            with network.process(robot, "sim"):
                node = tfbus.Node("sim")
            network.run(10.0)

    The seed decides all that is left to chance. `interleaving` is the mean number of steps after
    which a task gives its turn away without need. The attribute `faults` says how often Zenoh
    fails. Hosts and processes are given themselves, or by their names. Settings that the
    environment had before (TFBUS_MODE and others) have no effect.
    """

    def __init__(self, seed: int = 0, *, interleaving: int = 50) -> None:
        self.seed = seed
        self._interleaving = interleaving
        self._stack = ExitStack()
        self.faults = Faults()
        self._paths = Paths()
        self._in_force: ProcessTable | None = None

    # In force

    def __enter__(self) -> "Network":
        if scheduler.is_simulated:
            raise SimulationError("one simulated network at a time")
        tasks = Tasks(self.seed, _Driver(), interleaving=self._interleaving)
        self._fabric = Fabric(tasks, self._paths, self.faults)
        self._in_force = ProcessTable(tasks, self._fabric)
        self._was_collecting = gc.isenabled()
        gc.disable()  # finalizers at any moment would make no two runs the same
        self.outside = self.host(OUTSIDE)
        self.tasks.main.place = self._table.add(self.outside, "main")
        names = scheduler_names(self.tasks)
        with ExitStack() as stack:
            stack.enter_context(on_one_cpu())
            stack.enter_context(without_settings())
            stack.enter_context(random_numbers_of(self.seed))
            stack.enter_context(scheduler.replaced_by(names))
            stack.enter_context(standing_in(self._table, names))
            stack.enter_context(zenoh_library.replaced_by(self._fabric))
            self._stack = stack.pop_all()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            self.tasks.end()
        finally:
            self._stack.close()
            if self._was_collecting:
                gc.enable()
        failure, self.tasks.failure = self.tasks.failure, None
        if (raised := error or failure) is not None:
            raised.add_note(f"again: Network(seed={self.seed})")
        if failure is not None and error is None:
            raise failure

    # Hosts and processes

    @called_as('network.host("robot", offset_s=0.3, drift_ppm=20.0)')
    def host(self, name: str, *, offset_s: float = 0.0, drift_ppm: float = 0.0) -> Host:
        """The host of this name, made the first time.

        Its clock is `offset_s` ahead of the others and gains `drift_ppm` microseconds a second;
        `host.step_clock` sets it. Endpoints name it: `tcp/NAME:7447`. Raises SimulationError for
        another clock than it has.
        """
        return self._table.host_with_clock(name, offset_s, drift_ppm)

    @contextmanager
    def process(self, host: Host | str, name: str) -> Iterator[Process]:
        """Make a process on a host: all calls until the end of the `with` happen in it."""
        process = self._table.add(self._host(host), name)
        with self.tasks.within(process):
            yield process

    @contextmanager
    def within(self, process: Process | str) -> Iterator[None]:
        """Enter a process: all calls until the end of the `with` happen in it."""
        entered = self._process(process)
        if not entered.is_running:
            raise SimulationError(f"process {entered.name!r} does not run: nothing happens in it")
        with self.tasks.within(entered):
            yield

    def start(
        self, host: Host | str, name: str, main: Callable[..., object], *args: Any, **named: Any
    ) -> Process:
        """Start a process that runs `main(*args, **named)` and ends with it.

        An exception of `main` fails the test. SystemExit(0) of a command line does not.
        """
        _check_plain("main", main)
        process = self._table.add(self._host(host), name)

        def run() -> None:
            try:
                main(*args, **named)
            except SystemExit as error:
                if error.code:
                    raise SimulationError(f"{process.name} exits: {error.code}") from error
            self._table.finish(process)

        process.begin = partial(self.start, process.host, name, main, *args, **named)
        self._table.run(process, run)
        return process

    def program(
        self,
        host: Host | str,
        main: Callable[[], object] | str,
        *arguments: str,
        name: str = "",
        env: Mapping[str, str] | None = None,
        stdin: str = "",
        is_terminal: bool = False,
        is_merged: bool = False,
    ) -> Program:
        """Start a process that runs `main()` as `python -m MODULE ARGUMENTS` does, with the module
        of `main`: with `sys.argv`, an environment (`env`; None: the test's), input, output
        and exit code of its own. In a terminal, or merged, it writes its errors with its output.
        `main` may be an installed command, such as "tfbus". Raises SimulationError for others.
        """
        if isinstance(main, str):
            name, main = name or main, main_of_command(main)
        _check_plain("main", main)
        for each in arguments:
            if not isinstance(each, str):
                raise SimulationError(f"arguments of a program are texts, not {each!r}")
        name = name or module_of(main).rpartition(".")[2]
        process = self._table.add(self._host(host), name)
        process.program = Program(
            self,
            self._table,
            process,
            main,
            arguments,
            os.environ if env is None else env,
            stdin,
            is_terminal=is_terminal,
            is_merged=is_merged,
        )

        def begin() -> Process:
            again = self.program(
                process.host,
                main,
                *arguments,
                name=name,
                env=env,
                stdin=stdin,
                is_terminal=is_terminal,
                is_merged=is_merged,
            )
            return again.process

        process.begin = begin
        self._table.run(process, process.program.run)
        return process.program

    def signal(self, process: Process | str, number: int) -> None:
        """Send a signal to a process: its handler is called at the next turn of its main thread."""
        self._table.signal(self._process(process), number)

    def kill(self, process: Process | str) -> None:
        """End a process at once, as SIGKILL does: its host closes its sockets."""
        self._table.signal(self._process(process), signal.SIGKILL)

    def restart(self, process: Process | str) -> Process:
        """Kill a process that has a main function, if it still runs, and start it anew."""
        former = self._process(process)
        if former.begin is None:
            raise SimulationError(
                f"process {former.name!r} has no main function to restart: begin it by "
                "network.start(host, name, main) or network.program(host, main)"
            )
        self.kill(former)
        return former.begin()

    def power_off(self, host: Host | str) -> None:
        """End all processes of a host without a word to others, as a pulled plug does."""
        for process in self._host(host).processes:
            self._table.vanish(process)

    def stop(self, process: Process | str) -> None:
        """Stop a process, as SIGSTOP does."""
        self._table.stop(self._process(process))

    def go_on(self, process: Process | str) -> None:
        """Let a stopped process go on, as SIGCONT does."""
        self._table.go_on(self._process(process))

    # Paths

    @called_as('network.path("robot", "base", delay_s=0.02, loss=0.1, bytes_a_second=1e6)')
    def path(
        self,
        one: Host | str,
        other: Host | str,
        *,
        delay_s: float = 0.0002,
        jitter_s: float = 0.0001,
        loss: float = 0.0,
        reordering: float = 0.0,
        bytes_a_second: float = 0.0,
        multicast: bool = True,
    ) -> None:
        """Set how two hosts reach each other, both ways.

        Each packet takes `delay_s`, and up to `jitter_s` more; the share `loss` of all packets is
        lost, and the share `reordering` takes twice as long. On links of TCP, which tfbus uses
        unless an endpoint says `udp`, both only delay later ones; on links of UDP a lost packet
        is lost, and so is one that another overtakes. More than `bytes_a_second` (0: no bound)
        waits, and is dropped if too much does. Without `multicast` peers meet only at the
        endpoints of `connect`, or introduced by others. Shares are below 1: `cut` lets nothing
        pass.
        """
        for name, share in (("loss", loss), ("reordering", reordering)):
            if not 0.0 <= share < 1.0:
                raise SimulationError(
                    f"{name} is a share from 0 to below 1, not {share!r}: 0.3 is 30 %, and "
                    "network.cut(one, other) lets nothing pass"
                )
        rates = {"delay_s": delay_s, "jitter_s": jitter_s, "bytes_a_second": bytes_a_second}
        for name, rate in rates.items():
            _check_number(name, rate)
        for path in self._paths.both_ways(self._host(one), self._host(other)):
            path.delay_s, path.jitter_s, path.loss = delay_s, jitter_s, loss
            path.reordering, path.multicast = reordering, multicast
            path.bytes_a_second = bytes_a_second

    def partition(self, *groups: Iterable[Host | str] | Host | str) -> None:
        """Let nothing pass between the groups, such as `"robot", "base"` or `["a", "b"], "c"`.

        Hosts of no group still reach all others, except of a single group, which is cut off from
        all of them.
        """
        sides = [
            [self._host(each) for each in ([group] if isinstance(group, Host | str) else group)]
            for group in groups
        ]
        if len(sides) == 1:
            sides.append([host for host in self._table.hosts.values() if host not in sides[0]])
        named = [host for side in sides for host in side]
        for host in named:
            if named.count(host) > 1:
                raise SimulationError(f"host {host.name!r} is in two groups of a partition")
        for side in sides:
            for one in side:
                for other in named:
                    if other not in side:
                        self._fabric.set_up(one, other, False)

    def cut(self, one: Host | str, other: Host | str, *, both_ways: bool = True) -> None:
        """Let nothing pass between two hosts, or only not from the first to the second."""
        self._fabric.set_up(self._host(one), self._host(other), False)
        if both_ways:
            self._fabric.set_up(self._host(other), self._host(one), False)

    def roam(self, host: Host | str, address: str = "") -> None:
        """Give a host another address, as another access point does: its links are lost.

        The host notices at once, the others after the lease. `path` says how it is reached then.
        Endpoints may name it by `address`.
        """
        moved = self._host(host)
        moved.address = address or moved.name
        self._fabric.address_changed(moved)

    def heal(self) -> None:
        """Let everything pass again."""
        for one in self._table.hosts.values():
            for other in self._table.hosts.values():
                self._fabric.set_up(one, other, True)

    def _host(self, host: Host | str) -> Host:
        return host if isinstance(host, Host) else self._table.host(host)

    def _process(self, process: Process | str) -> Process:
        if isinstance(process, Host):
            names = ", ".join(each.name for each in process.processes) or "none yet"
            raise SimulationError(f"{process.name!r} is a host, not one of its processes: {names}")
        return process if isinstance(process, Process) else self._table.process(process)

    # Running

    @called_as("network.run(2.0), or network.run(until=condition, timeout_s=60.0)")
    def run(
        self,
        seconds: float | None = None,
        *,
        until: Callable[[], object] | None = None,
        timeout_s: float = 60.0,
    ) -> float:
        """Let the network run for so many seconds, or until a condition holds.

        Returns the seconds that have passed. Raises SimulationError if the condition does not
        hold after `timeout_s`.
        """
        if self.tasks.is_over:
            raise SimulationError(_IN_FORCE)
        if seconds is None and until is None:
            raise SimulationError(
                "run for how long? Give seconds, run(2.0), or a condition, run(until=condition)"
            )
        _check_number("seconds", timeout_s if seconds is None else seconds)
        begun_ns = self.tasks.now_ns
        if until is None:
            assert seconds is not None
            self.tasks.wait("the end of a run", seconds)
        else:
            _check_plain("until", until)
            end_ns = begun_ns + round((timeout_s if seconds is None else seconds) * 1e9)
            while not until():
                if self.tasks.now_ns >= end_ns:
                    waited_s = (end_ns - begun_ns) / 1e9
                    raise SimulationError(
                        f"the condition does not hold after {waited_s:g} s (seed {self.seed})"
                        + "".join(map(_failure, self._table.processes()))
                    )
                self.tasks.wait("a condition of the test", _LOOK_EVERY_S)
        return (self.tasks.now_ns - begun_ns) / 1e9

    @property
    def tasks(self) -> Tasks:
        """The tasks of all processes."""
        return self._table.tasks

    @property
    def _table(self) -> ProcessTable:
        if self._in_force is None:
            raise SimulationError(_IN_FORCE)
        return self._in_force

    @property
    def dropped(self) -> int:
        """How many messages congested links have dropped."""
        return self._fabric.dropped

    @property
    def now_ns(self) -> int:
        """The true time, in nanoseconds since the Unix epoch; hosts have clocks of their own."""
        return START_NS + self.tasks.now_ns


def _check_plain(what: str, function: object) -> None:
    """Refuse a coroutine function, whose call would do nothing, and any object but a function."""
    if not callable(function) or inspect.iscoroutinefunction(function):
        raise SimulationError(
            f"{what} must be a function without `async`, and not called yet, not {function!r}: of "
            "a coroutine give lambda: asyncio.run(main())"
        )


def _check_number(what: str, number: object) -> None:
    if not isinstance(number, Real) or not 0 <= float(number) < math.inf:
        raise SimulationError(f"{what} must be a number from 0 on, not {number!r}")


class _Driver:
    """The place of the test itself, before it is in any process."""

    name = "test"
    is_stopped = False
    is_dead = False

    def __init__(self) -> None:
        self.parked: list[Task] = []

    def enter(self) -> None:
        """Nothing is its own."""

    leave = enter


_PREFIX = "TFBUS_"


@contextmanager
def without_settings() -> Iterator[None]:
    """Hide TFBUS_MODE, TFBUS_CONNECT and the like until the end of the `with`."""
    hidden = {name: os.environ.pop(name) for name in list(os.environ) if name.startswith(_PREFIX)}
    try:
        yield
    finally:
        os.environ.update(hidden)


def _failure(process: Process) -> str:
    """A line that says how a program has failed; "" for other processes."""
    program, code = process.program, process.exit_code
    if program is None or not code or code < 0:
        return ""
    said = program.stderr.strip().rpartition("\n")[2]
    return f"\n{process.name} has ended with {code}: {said or 'it wrote no error'}"
