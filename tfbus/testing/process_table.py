"""The process table of a simulated network: its hosts and processes, their ends and signals."""

import signal
import threading
from collections.abc import Callable
from functools import partial

from tfbus.testing.fabric import Fabric
from tfbus.testing.of_python import task_of
from tfbus.testing.processes import Host, Process
from tfbus.testing.tasks import SimulationError, Tasks

# Signals that do nothing by default.
_IGNORED = {
    number
    for name in ("SIGCHLD", "SIGURG", "SIGWINCH")
    if (number := getattr(signal, name, None)) is not None
}


class ProcessTable:
    """All hosts and processes, and what a kernel does for them."""

    def __init__(self, tasks: Tasks, fabric: Fabric) -> None:
        self.tasks = tasks
        self._fabric = fabric
        self.hosts: dict[str, Host] = {}
        self._pids = 1000

    # Who is there

    def host(self, name: str) -> Host:
        """The host of this name. Raises SimulationError if there is none."""
        if name not in self.hosts:
            known = ", ".join(repr(each) for each in self.hosts)
            raise SimulationError(
                f"the network has no host {name!r}, but {known}: make it by network.host({name!r})"
            )
        return self.hosts[name]

    def process(self, name: str) -> Process:
        """The latest process of the name "host/process". Raises SimulationError without one."""
        names = []
        for host in self.hosts.values():
            for each in reversed(host.processes):
                if each.name == name:
                    return each
                names.append(repr(each.name))
        raise SimulationError(
            f"the network has no process {name!r}, but {', '.join(sorted(set(names)))}"
        )

    def current_process(self) -> Process:
        """The process whose turn it is."""
        return self.tasks.current.place  # type: ignore[return-value]

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
            process.is_dead = True
            process.ended.wake_all()
            self._fabric.process_ended(process)

    def vanish(self, process: Process) -> None:
        """End a process without a word to others."""
        process.is_dead = True
        process.ended.wake_all()
        self._fabric.process_vanished(process)

    def forget_at_exit(self, call: Callable[..., object]) -> None:
        """As `atexit.unregister`, in whichever process it was registered."""
        for host in self.hosts.values():
            for process in host.processes:
                process.forget_at_exit(call)

    # Signals

    def signal(self, process: Process, number: int) -> None:
        """Send a signal to a process: its handler is called at the next turn of its main thread."""
        if process.is_dead:
            return
        handler = process.handler(number)
        if number == signal.SIGSTOP:
            self.stop(process)
        elif number == signal.SIGCONT:
            self.go_on(process)
        elif number == signal.SIGKILL or handler == signal.SIG_DFL or process.main is None:
            if number not in _IGNORED:
                process.exit_code = -number
                self.end(process)
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
        process.is_stopped = True
        self._fabric.process_stopped(process)

    def go_on(self, process: Process) -> None:
        """As SIGCONT."""
        process.go_on()
        self._fabric.process_goes_on(process)
