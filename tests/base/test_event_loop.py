"""asyncio between callbacks: its end."""

import asyncio

from tfbus.base.event_loop import EventLoop


class Steps:
    """An observer to which steps are nothing."""

    def begin_step(self, what: str) -> None:
        """A step begins."""

    def end_step(self) -> None:
        """A step has ended."""

    def note_failure(self, what: str) -> None:
        """Say that nothing has failed here."""
        raise AssertionError(what)


def test_a_coroutine_takes_its_last_steps_though_a_ring_was_not_heard() -> None:
    """A ring that comes as the loop closes ends a `run` that there is no more."""
    loop, steps = EventLoop(Steps()), list[str]()

    async def wait() -> None:
        try:
            await asyncio.sleep(60.0)
        finally:
            await asyncio.sleep(0.0)
            steps.append("last")

    loop.start("wait", wait())
    loop.turn()
    loop.ring()
    loop.close()
    assert steps == ["last"]
