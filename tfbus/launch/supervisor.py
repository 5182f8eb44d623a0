"""Starts programs in their order, keeps them running, and ends all of them together.

Each program has an asyncio task, which waits for the nodes in `after:`, starts the program, waits
for its end, and starts it again if it respawns.
"""

import asyncio
import signal
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Protocol

from tfbus.base.callbacks import Given
from tfbus.base.errors import TfbusError
from tfbus.base.wording import counted, listed
from tfbus.launch.child import Child, Escalation, LaunchProgram, Timeouts
from tfbus.launch.console import Console

# There is no event for an empty process group.
_GROUP_POLL_S = 0.02


class Presence(Protocol):
    """The nodes on the bus."""

    def wait(self, name: str, *, timeout_s: float | None = None) -> bool:
        """Whether the node of this full name appears within `timeout_s`."""


class GroupGuard(Protocol):
    """Ends the process groups that it watches if launch itself is killed."""

    def watch(self, group: int) -> None:
        """A group was started."""

    def release(self, group: int) -> None:
        """A group has ended."""


class Supervisor:
    """The programs of one launch, from the start of the first to the end of the last.

    Its methods are for the thread of the asyncio loop that `run` runs in.
    """

    def __init__(
        self,
        programs: Sequence[LaunchProgram],
        console: Console,
        *,
        presence: Presence | None = None,
        guard: GroupGuard | None = None,
        timeouts: Timeouts | None = None,
    ) -> None:
        self._programs = programs
        self._console = console
        self._presence = presence
        self._guard = guard
        self._timeouts = timeouts or Timeouts()
        self._children: list[Child] = []  # in the order of their starts
        self._arrived: set[str] = set()  # full names of awaited nodes that came
        self._begun: set[str] = set()  # full names of programs that were started
        self._over: set[str] = set()  # full names of programs that do not run again
        self._escalation = Escalation(self._children, console, self._timeouts, self._give_up)
        self._was_asked_to_stop = self._has_failed = False
        self._died: list[str] = []  # the programs that ended by themselves, and failed
        self._changed = asyncio.Event()
        self._tasks: list[asyncio.Task[None]] = []

    @property
    def pids(self) -> set[int]:
        """The processes started here that still run."""
        return {child.pid for child in self._children if child.exit_code is None}

    async def run(self) -> int:
        """Run all programs until the last has ended; the exit code of the launch.

        0 if all finished cleanly, or ran until it was asked to stop; 1 if a process died before
        that, a required one ended, or one could not be started. It leaves no process group in any
        case.
        """
        self._await_nodes()
        self._tasks = [asyncio.create_task(self._keep(program)) for program in self._programs]
        try:
            with suppress(asyncio.CancelledError):  # by _give_up
                await asyncio.gather(*self._tasks)
        finally:
            self._escalation.cancel()
            for child in self._children:
                child.send(signal.SIGKILL)
        return 1 if self._has_failed or self._died else 0

    @property
    def status(self) -> str:
        """How many processes run, as a sentence without its end."""
        return f"{len(self.pids)} of {counted(len(self._programs), 'program')} running"

    async def started(self) -> None:
        """Wait until each program has been started, or will not be."""
        names = {program.full_name for program in self._programs}
        while not names <= self._begun | self._over:
            await self._changed.wait()

    def stop(self, reason: str, *, level: str = "WARNING") -> None:
        """Begin to end all programs, unless that has begun."""
        if not self._is_stopping:
            self.hurry(reason, level=level)

    def hurry(
        self, reason: str, at_least: signal.Signals = signal.SIGINT, *, level: str = "WARNING"
    ) -> None:
        """Begin to end all programs; if that has begun, send the next signal at once.

        `at_least` skips the signals before it. The user asked for this, so that the processes
        which it ends have not failed.
        """
        is_first = not self._is_stopping
        self._was_asked_to_stop |= is_first
        self._say(level, "launch", reason)
        if is_first and self._died:
            self._say("ERROR", "launch", f"died before: {listed(self._died)}; exit code 1")
        self._escalate(at_least)

    # -- one program

    async def _keep(self, program: LaunchProgram) -> None:
        """Start the program, and start it again as its respawn says."""
        if await self._may_start(program):
            await self._run_and_respawn(program)
        self._over.add(program.full_name)
        self._wake()
        if program.required and not self._is_stopping:
            self._fail(program.name, "required process has ended: stopping all others")

    async def _may_start(self, program: LaunchProgram) -> bool:
        """Wait for the nodes in `after:`; False if the program must not start."""
        for name in program.after:

            def is_settled(name: str = name) -> bool:
                return self._is_stopping or name in self._arrived or name in self._over

            while not await self._until(is_settled, self._timeouts.notice_s):
                self._say("INFO", program.name, f"waiting for {name}")
            if not self._is_stopping and name not in self._arrived:
                self._has_failed = True
                self._say("ERROR", program.name, f"not started: {name} has ended")
                return False
        return not self._is_stopping

    async def _run_and_respawn(self, program: LaunchProgram) -> None:
        loop = asyncio.get_running_loop()
        in_a_row = 0
        while not self._is_stopping:
            started_s = loop.time()
            exit_code = await self._run_once(program)
            if self._is_stopping:
                return
            if program.respawn is None:
                self._note_end(program, exit_code)
                return
            if loop.time() - started_s >= program.respawn.steady_s:
                in_a_row = 0
            delay_s = program.respawn.delay_before(in_a_row)
            if delay_s is None:
                self._note_end(program, exit_code)
                self._say("ERROR", program.name, f"not started again: {in_a_row} times in a row")
                return
            in_a_row += 1
            self._say("INFO", program.name, f"process will be started again in {delay_s:g} s")
            await self._until(lambda: self._is_stopping, delay_s)

    def _note_end(self, program: LaunchProgram, exit_code: int) -> None:
        """Note the end of a program that is not started again, and was not told to end."""
        if exit_code:
            self._died.append(program.name)

    async def _run_once(self, program: LaunchProgram) -> int:
        """Start the program and wait for its end and its group's; its exit code."""
        try:
            child = Child(program)
        except (OSError, ValueError) as error:
            reason = f"process cannot be started: {error}: cmd '{program.command_line}'"
            self._fail(program.name, reason)
            return 1
        self._children.append(child)
        self._begun.add(program.full_name)
        self._wake()
        if self._guard:
            self._guard.watch(child.pid)
        self._say("INFO", program.name, f"process started with pid [{child.pid}]")
        child.follow(self._console, self._wake)
        exit_code = await self._end_of(child)
        await self._end_of_group(child)
        if self._guard:
            self._guard.release(child.pid)
        self._children.remove(child)
        # Its last output comes before its end; a process outside the group may hold its pipes.
        await self._until(lambda: child.output_ended, 1.0)
        self._log_end(child, exit_code)
        return exit_code

    async def _end_of(self, child: Child) -> int:
        while child.exit_code is None:
            await self._changed.wait()
        return child.exit_code

    async def _end_of_group(self, child: Child) -> None:
        """Wait until the group is empty; end it unless everything is being ended anyway."""
        if not child.group_lives:
            return
        killing = None
        if not self._is_stopping:
            text = "left processes behind: sending them 'SIGTERM'"
            self._say("WARNING", child.program.name, text)
            child.send(signal.SIGTERM)
            killing = asyncio.get_running_loop().call_later(
                self._timeouts.after_sigterm_s, child.send, signal.SIGKILL
            )
        while child.group_lives:
            await asyncio.sleep(_GROUP_POLL_S)
        if killing:
            killing.cancel()

    def _log_end(self, child: Child, exit_code: int) -> None:
        if exit_code == 0:
            text = f"process has finished cleanly [pid {child.pid}]"
            self._say("INFO", child.program.name, text)
            return
        text = f"[pid {child.pid}, exit code {exit_code}"
        if self._escalation.explains(exit_code):
            self._say("INFO", child.program.name, f"process has stopped {text}]")
            return
        text = f"process has died {text}, cmd '{child.program.command_line}']"
        self._say("ERROR", child.program.name, text)

    # -- all of them

    @property
    def _is_stopping(self) -> bool:
        return self._escalation.has_begun

    def _fail(self, name: str, text: str) -> None:
        """Log the fault and end everything, with exit code 1."""
        if not self._was_asked_to_stop:
            self._has_failed = True
        self._say("ERROR", name, text)
        if not self._is_stopping:
            self._escalate(signal.SIGINT)

    def _escalate(self, at_least: signal.Signals) -> None:
        self._escalation.escalate(at_least)
        self._wake()

    def _give_up(self) -> None:
        self._has_failed = True
        for task in self._tasks:
            task.cancel()

    def _await_nodes(self) -> None:
        """Have a thread wait for each node in an `after:`."""
        names = {name for program in self._programs for name in program.after}
        presence, loop = self._presence, asyncio.get_running_loop()
        assert presence or not names, "a presence is needed where programs wait for nodes"

        def notify(callback: Callable[[*Given], None], *given: *Given) -> None:
            with suppress(RuntimeError):  # the loop is closed
                loop.call_soon_threadsafe(callback, *given)

        def wait_for(name: str) -> None:
            try:
                if presence and presence.wait(name):
                    notify(self._arrive, name)
            except TfbusError as error:
                notify(self._fail, "launch", str(error))

        for name in names:
            threading.Thread(target=wait_for, args=(name,), daemon=True).start()

    def _arrive(self, name: str) -> None:
        self._arrived.add(name)
        self._wake()

    async def _until(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        """Whether the condition comes true in time; it is checked after each change."""
        with suppress(TimeoutError):
            async with asyncio.timeout(timeout_s):
                while not condition():
                    await self._changed.wait()
        return condition()

    def _wake(self) -> None:
        """Wake all that wait for a change."""
        changed, self._changed = self._changed, asyncio.Event()
        changed.set()

    def _say(self, level: str, name: str, text: str) -> None:
        self._console.say(level, name, text)
