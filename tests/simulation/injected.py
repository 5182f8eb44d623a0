"""Defects put back by hand: do the histories find them? python -m tests.simulation.injected

Each takes the place of a real function. Prints for each in how many seconds of the processor, and
with which seed, the laws have found it; without `--from` and `--seconds` within a minute from seed
0 on.
"""

import argparse
import itertools
import logging
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any
from weakref import WeakKeyDictionary

from tests.simulation.histories import violation
from tests.simulation.plans import Plan
from tfbus.base.clock import Timer
from tfbus.base.executor import Executor
from tfbus.streams.conflicts import Claims, Starts
from tfbus.streams.queries import StaticRecovery
from tfbus.streams.registry import UnlistedFrames
from tfbus.streams.stream_facts import Epochs, Listing, Verdict
from tfbus.streams.watch import StreamWatch

# The class of a function, the function, and the defect in its place. If a function is renamed, the
# import of this file fails.
_Patch = tuple[type, Callable[..., Any], Callable[..., Any]]

_judge, _take_token, _tick = Epochs.judge, StreamWatch._take_token, Executor._tick
_words = itertools.count()
_arrivals: WeakKeyDictionary[Starts, dict[Any, tuple[int, int]]] = WeakKeyDictionary()


def _present(epochs: Epochs, epoch_ns: int) -> Verdict:
    """Messages of all epochs count."""
    return _judge(epochs, epoch_ns) if epochs.present_ns is None else Verdict.PRESENT


def _is_outdated(epochs: Epochs, epoch_ns: int) -> bool:
    """Any other epoch is a new one."""
    return False


def _check_nothing(recovery: StaticRecovery, key: str, stream: object) -> None:
    """A static transform that has not come is not queried."""


def _alive_at_once(watch: StreamWatch, key: str, alive: bool, came_s: float) -> None:
    """A token that is back is taken for the process of before, with its description."""
    _take_token(watch, key, alive, came_s)
    if alive:
        watch._states.take_back(key)


def _nothing_removed(listing: Listing, epoch_ns: int) -> frozenset[str]:
    """A kept message brings back what was removed."""
    return frozenset()


def _hear_nothing(unlisted: UnlistedFrames, stream: str, frames: object) -> None:
    """A frame that comes again after its removal stays."""


def _by_arrival(starts: Starts, stream: str, description: Any) -> tuple[int, int]:
    """The first to arrive has priority."""
    first = _arrivals.setdefault(starts, {})
    return first.setdefault((stream, description.session), (next(_words), 0))


def _by_last_word(claims: Claims, stream: str, description: Any) -> tuple[int, int, int, str]:
    """The stream that has described itself last has priority."""
    return -next(_words), 0, 0, stream


def _cancel_nothing(timer: Timer) -> None:
    """A timer that is cancelled ticks on."""


def _tick_once_more(executor: Executor, when_s: float, timer: Timer) -> Any:
    """A timer that is cancelled while it is due ticks once more."""
    if timer.cancelled and not timer.once:
        return timer.fire()
    return _tick(executor, when_s, timer)


DEFECTS: dict[str, tuple[_Patch, ...]] = {
    "an epoch is not compared": ((Epochs, _judge, _present),),
    "every other epoch is new": ((Epochs, Epochs.is_outdated, _is_outdated),),
    "a static is not queried again": ((StaticRecovery, StaticRecovery.check, _check_nothing),),
    "a token is taken for a process": ((StreamWatch, _take_token, _alive_at_once),),
    # By one guard alone no law is violated: what a kept message brings back goes within 2 s. But
    # without `removed_in` it stays where its publisher ends meanwhile, as test_listeners shows.
    "a late message undoes a removal": (
        (Listing, Listing.removed_in, _nothing_removed),
        (UnlistedFrames, UnlistedFrames.hear, _hear_nothing),
    ),
    "a claim is judged by arrival": ((Starts, Starts.start_ns, _by_arrival),),
    "a claim is judged by the last word": ((Claims, Claims._rank, _by_last_word),),
    "a timer is not cancelled": ((Timer, Timer.cancel, _cancel_nothing),),
    "a timer that is due is not cancelled": ((Executor, _tick, _tick_once_more),),
}


@contextmanager
def injected(name: str) -> Iterator[None]:
    """The defect of this name, until the end of the `with`."""
    patches = DEFECTS[name]
    try:
        for owner, function, defect in patches:
            setattr(owner, function.__name__, defect)
        yield
    finally:
        for owner, function, _ in patches:
            setattr(owner, function.__name__, function)


def main() -> None:
    """Put each defect in, and see when it is found."""
    logging.getLogger("asyncio").setLevel(logging.CRITICAL)  # coroutines of killed processes
    parser = argparse.ArgumentParser()
    parser.add_argument("defects", nargs="*", help="all by default")
    parser.add_argument("--from", dest="first", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=60.0)
    options = parser.parse_args()
    for name in options.defects or DEFECTS:
        with injected(name), suppress(KeyboardInterrupt):
            _look_for(name, options.first, options.seconds)


def _look_for(name: str, first: int, seconds: float) -> None:
    begun_s, seed = time.process_time(), first
    while time.process_time() < begun_s + seconds:
        if found := violation(Plan.drawn(seed)):
            took_s = time.process_time() - begun_s
            print(f"{name}: {took_s:.1f} s, seed {seed}: {found.splitlines()[0]}", flush=True)
            return
        seed += 1
    print(f"{name}: not found in {seconds:g} s, seeds {first} to {seed - 1}", flush=True)


if __name__ == "__main__":
    main()
