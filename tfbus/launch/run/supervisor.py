"""Starts programs in their order, keeps them running, and ends all of them together.

One asyncio task stands for each program: it waits for those that must be there first, starts
it, waits for its end and starts it again where that is wanted.
"""

import asyncio
import signal
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Protocol

from tfbus.errors import TfbusError
from tfbus.launch.run.child import Child
from tfbus.launch.run.console import Console
from tfbus.launch.run.escalation import RUNGS, Patience, StopLadder
from tfbus.launch.run.program import Program

# What a process ends with that obeys one of our signals: killed by it, or as a shell says so.
_OBEYED = {code for rung in RUNGS for code in (-rung, 128 + rung)}
# No event tells that a process group is empty.
_GROUP_POLL_S = 0.02


class Presence(Protocol):
    """Knows which nodes are on the bus."""

    def wait(self, name: str, *, timeout_s: float | None = None) -> bool:
        """Whether the node of this full name is there, waited for at most `timeout_s`."""


class Guard(Protocol):
    """Ends the process groups that it watches should launch itself be killed."""

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
        programs: Sequence[Program],
        console: Console,
        *,
        presence: Presence | None = None,
        guard: Guard | None = None,
        patience: Patience | None = None,
    ) -> None:
        self._programs = programs
        self._console = console
        self._presence = presence
        self._guard = guard
        self._patience = patience or Patience()
        self._children: list[Child] = []  # in the order of their starts
        self._arrived: set[str] = set()  # full names of awaited nodes that came
        self._over: set[str] = set()  # full names of programs that will not run again
        self._ladder = StopLadder(self._children, console, self._patience, self._give_up)
        self._was_asked_to_stop = self._has_failed = self._someone_died = False
        self._news = asyncio.Event()
        self._tasks: list[asyncio.Task[None]] = []

    @property
    def pids(self) -> set[int]:
        """The processes that were started here and have not ended."""
        return {child.pid for child in self._children if child.exit_code is None}

    async def run(self) -> int:
        """Run all programs until the last has ended; the exit code of the launch.

        0 if it was asked to stop or all finished cleanly; 1 if a process died, a required one
        ended, or one could not be started. However this ends, no process group is left.
        """
        self._await_nodes()
        self._tasks = [asyncio.create_task(self._keep(program)) for program in self._programs]
        try:
            with suppress(asyncio.CancelledError):  # by _give_up
                await asyncio.gather(*self._tasks)
        finally:
            self._ladder.leave()
            for child in self._children:
                child.send(signal.SIGKILL)
        died = self._someone_died and not self._was_asked_to_stop
        return 1 if self._has_failed or died else 0

    def stop(self, reason: str) -> None:
        """Begin to end all programs; nothing more happens if that has begun."""
        if not self._is_stopping:
            self.hurry(reason)

    def hurry(self, reason: str, at_least: signal.Signals = signal.SIGINT) -> None:
        """Begin to end all programs, or go on to the next signal at once if that has begun.

        `at_least` skips the signals before it. This is a user's wish: the exit code will be 0.
        """
        if not self._is_stopping:
            self._was_asked_to_stop = True
        self._say("WARNING", "launch", reason)
        self._climb(at_least)

    # -- one program

    async def _keep(self, program: Program) -> None:
        """Start the program and start it again for as long as that is wanted."""
        if await self._may_start(program):
            await self._run_and_respawn(program)
        self._over.add(program.full_name)
        self._tell()
        if program.required and not self._is_stopping:
            self._fail(program.name, "required process has ended: stopping all others")

    async def _may_start(self, program: Program) -> bool:
        """Wait for the nodes that must be there first; False if the program is not to start."""
        for name in program.after:

            def is_settled(name: str = name) -> bool:
                return self._is_stopping or name in self._arrived or name in self._over

            while not await self._until(is_settled, self._patience.notice_s):
                self._say("INFO", program.name, f"waiting for {name} to be on the bus")
            if not self._is_stopping and name not in self._arrived:
                self._has_failed = True
                self._say("ERROR", program.name, f"will not be started: {name} has ended")
                return False
        return not self._is_stopping

    async def _run_and_respawn(self, program: Program) -> None:
        loop = asyncio.get_running_loop()
        in_a_row = 0
        while not self._is_stopping:
            started_s = loop.time()
            exit_code = await self._run_once(program)
            if self._is_stopping:
                return
            if program.respawn is None:
                self._someone_died |= exit_code != 0
                return
            if loop.time() - started_s >= program.respawn.steady_s:
                in_a_row = 0
            delay_s = program.respawn.delay_before(in_a_row)
            if delay_s is None:
                self._someone_died |= exit_code != 0
                self._say("ERROR", program.name, f"not started again: {in_a_row} times in a row")
                return
            in_a_row += 1
            self._say("INFO", program.name, f"process will be started again in {delay_s:g} s")
            await self._until(lambda: self._is_stopping, delay_s)

    async def _run_once(self, program: Program) -> int:
        """Start the program and wait for its end and its group's; its exit code."""
        try:
            child = Child(program)
        except (OSError, ValueError) as error:
            reason = f"process cannot be started: {error}: cmd '{program.command_line}'"
            self._fail(program.name, reason)
            return 1
        self._children.append(child)
        if self._guard:
            self._guard.watch(child.pid)
        self._say("INFO", program.name, f"process started with pid [{child.pid}]")
        child.follow(self._console, self._tell)
        exit_code = await self._end_of(child)
        await self._end_of_group(child)
        if self._guard:
            self._guard.release(child.pid)
        self._children.remove(child)
        # What it wrote last stands before its end; someone outside the group may hold its pipes.
        await self._until(lambda: child.has_told_all, 1.0)
        self._tell_end(child, exit_code)
        return exit_code

    async def _end_of(self, child: Child) -> int:
        while child.exit_code is None:
            await self._news.wait()
        return child.exit_code

    async def _end_of_group(self, child: Child) -> None:
        """Wait until nothing is left of the group, and see to it where nobody else does."""
        if not child.group_lives:
            return
        killing = None
        if not self._is_stopping:
            text = "left processes behind: sending signal 'SIGTERM' to them"
            self._say("WARNING", child.program.name, text)
            child.send(signal.SIGTERM)
            killing = asyncio.get_running_loop().call_later(
                self._patience.after_sigterm_s, child.send, signal.SIGKILL
            )
        while child.group_lives:
            await asyncio.sleep(_GROUP_POLL_S)
        if killing:
            killing.cancel()

    def _tell_end(self, child: Child, exit_code: int) -> None:
        if exit_code == 0:
            text = f"process has finished cleanly [pid {child.pid}]"
            self._say("INFO", child.program.name, text)
            return
        text = f"exit code {exit_code}, cmd '{child.program.command_line}'"
        obeyed = self._is_stopping and exit_code in _OBEYED
        self._say(
            "INFO" if obeyed else "ERROR",
            child.program.name,
            f"process has died [pid {child.pid}, {text}]",
        )

    # -- all of them

    @property
    def _is_stopping(self) -> bool:
        return self._ladder.is_climbed

    def _fail(self, name: str, text: str) -> None:
        """Say what went wrong and end everything, with exit code 1."""
        if not self._was_asked_to_stop:
            self._has_failed = True
        self._say("ERROR", name, text)
        if not self._is_stopping:
            self._climb(signal.SIGINT)

    def _climb(self, at_least: signal.Signals) -> None:
        self._ladder.climb(at_least)
        self._tell()

    def _give_up(self) -> None:
        self._has_failed = True
        for task in self._tasks:
            task.cancel()

    def _await_nodes(self) -> None:
        """Have a thread wait for each node that somebody waits for."""
        names = {name for program in self._programs for name in program.after}
        presence, loop = self._presence, asyncio.get_running_loop()
        assert presence or not names, "a presence is needed where programs wait for nodes"

        def tell(callback: Callable[[str], None], text: str) -> None:
            with suppress(RuntimeError):  # the loop is closed: nobody waits any more
                loop.call_soon_threadsafe(callback, text)

        def wait_for(name: str) -> None:
            try:
                if presence and presence.wait(name):
                    tell(self._arrive, name)
            except TfbusError as error:
                tell(lambda reason: self._fail("launch", reason), str(error))

        for name in names:
            threading.Thread(target=wait_for, args=(name,), daemon=True).start()

    def _arrive(self, name: str) -> None:
        self._arrived.add(name)
        self._tell()

    async def _until(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        """Whether the condition came true in time; it is looked at after each piece of news."""
        with suppress(TimeoutError):
            async with asyncio.timeout(timeout_s):
                while not condition():
                    await self._news.wait()
        return condition()

    def _tell(self) -> None:
        """Wake everyone who waits, to look again."""
        news, self._news = self._news, asyncio.Event()
        news.set()

    def _say(self, level: str, name: str, text: str) -> None:
        self._console.say(level, name, text)
