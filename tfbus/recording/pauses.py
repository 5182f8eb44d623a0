"""When a recorder recorded nothing though the bus went on, and how messages came but for that."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TypeAlias

from tfbus.core import lazy_numpy as np
from tfbus.core.lazy_numpy import NDArray
from tfbus.recording.items import EventItem
from tfbus.wording import printable

Ints: TypeAlias = "NDArray[np.int64]"

# Why nothing was recorded, where the recorder was not paused: the fact "why" of the event.
STOPPED, CUT_OUT = "stopped", "cut out"

# In what a recorder says of itself: equal in the files of one recording.
RECORDING = "recording"


@dataclass(frozen=True)
class Pause:
    """Nothing was recorded between two log times. `why` is "paused", "stopped" or "cut out"."""

    from_ns: int
    to_ns: int
    why: str = "paused"

    def said(self, start_ns: int) -> str:
        """A clause with the times since the beginning of the recording, as `--at` takes them."""
        from_s, to_s = ((each - start_ns) / 1e9 for each in (self.from_ns, self.to_ns))
        span = f"from {from_s:+.3f}s to {to_s:+.3f}s"
        if self.why == CUT_OUT:
            return f"what came {span} was cut out of the recording"
        return f"the recorder was {self.why} {span}"


def pauses_of(events: Iterable[EventItem], end_ns: int) -> tuple[Pause, ...]:
    """The pauses that these events tell of; one without an end lasts until `end_ns`."""
    found = []
    begun: EventItem | None = None
    for event in events:
        if event.kind == "paused" and begun is None:
            begun = event
        elif event.kind == "resumed" and begun is not None:
            found.append(Pause(begun.log_ns, event.log_ns, _why(begun)))
            begun = None
    if begun is not None:
        found.append(Pause(begun.log_ns, end_ns, _why(begun)))
    return tuple(found)


def recorded_ns(pauses: Iterable[Pause], from_ns: int, to_ns: int) -> int:
    """How long it was recorded between two log times."""
    inside = ((max(each.from_ns, from_ns), min(each.to_ns, to_ns)) for each in pauses)
    return to_ns - from_ns - sum(max(end - begin, 0) for begin, end in inside)


def _why(event: EventItem) -> str:
    why = event.facts.get("why")
    return printable(why, 40) if isinstance(why, str) and why else "paused"


def pauses_between(spans: Iterable[tuple[int, int, str]]) -> Iterator[EventItem]:
    """The events of a pause wherever no recorder ran. `spans` are the first and last log times of
    files, and which recording each is of, "" if it does not say.
    """
    until_ns, former = 0, ""
    for from_ns, to_ns, recording in sorted(spans):
        if former and recording and recording != former and from_ns > until_ns:
            yield EventItem(until_ns, "paused", facts={"why": STOPPED})
            yield EventItem(from_ns, "resumed")
        if to_ns > until_ns:
            until_ns, former = to_ns, recording


@dataclass(frozen=True, eq=False)
class Waits:
    """The times from each of N messages to the next: when they begin, and how long they are, each
    (N - 1,) in ns. With a pause in it, it is the longer of the waits before and after the pause,
    and not `is_whole` (N - 1,).
    """

    from_ns: Ints
    length_ns: Ints
    is_whole: NDArray[np.bool_]

    def period_s(self) -> float:
        """The median time from a message to the next; 0 for too few."""
        return float(np.median(self.length_ns)) * 1e-9 if len(self.length_ns) else 0.0

    def rate_hz(self) -> float | None:
        """Messages a second while it was recorded; None for too few."""
        span_s = float(self.length_ns[self.is_whole].sum()) * 1e-9
        return int(self.is_whole.sum()) / span_s if span_s > 0 else None


def waits_between(log_ns: Ints, pauses: Sequence[Pause]) -> Waits:
    """The waits between messages with these log times, which rise."""
    from_ns, length_ns = log_ns[:-1].copy(), np.diff(log_ns)
    is_whole = np.ones(len(length_ns), bool)
    for pause in pauses:
        at = int(np.searchsorted(log_ns, pause.from_ns, "right")) - 1
        if not 0 <= at < len(length_ns) or log_ns[at + 1] < pause.to_ns:
            continue  # none was sent before or after it; or another recorder was there
        before_ns = pause.from_ns - int(from_ns[at])
        after_ns = int(log_ns[at + 1]) - pause.to_ns
        if after_ns > before_ns:
            from_ns[at] = pause.to_ns
        length_ns[at] = max(before_ns, after_ns)
        is_whole[at] = False
    return Waits(from_ns, length_ns, is_whole)
