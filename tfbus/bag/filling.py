"""Fills the gaps of a recording from recorders elsewhere that serve their kept messages."""

import logging
import socket
from collections import deque
from collections.abc import Sequence
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass
from typing import Literal

from tfbus.bag.capture import Capture
from tfbus.bag.keeping import Fill
from tfbus.bag.kept import NODE, STREAM, wanted_of
from tfbus.bag.raw_queue import EVENTS, Raw
from tfbus.bag.recorder import Filled, Recorder
from tfbus.base.bounded import Bounded
from tfbus.base.errors import BusError, DecodeError, TfbusError
from tfbus.base.executor import Executor
from tfbus.base.log import LogOnce
from tfbus.base.own_pauses import own_pauses
from tfbus.base.wording import counted, duration, printable
from tfbus.bus.session import Session
from tfbus.recording.items import EventItem, EventKind, Selection
from tfbus.streams.history import AskPages, PagesInTurn
from tfbus.wire.keys import (
    ALL_KEEPERS,
    ALL_KEEPERS_EVERYWHERE,
    kept_selector,
    last_name,
    relative,
)
from tfbus.wire.pages import KeptMessage, Page

# A link is silent for this time, or less, before it is known to be lost; messages that came
# meanwhile all the same are left out.
_BEFORE_NS = 30_000_000_000

# The processes of a robot have their links back one after the other, within this time. Their last
# messages have to be on the disk there before they are asked for.
_OVERLAP_NS = 6_000_000_000
_AFTER_S = 8.0

# All that is lost with a link is noticed within this time.
_NOTICED_WITHIN_NS = 5_000_000_000

# Names come from the bus: of at most so many it is known when they were lost last.
_MOST_LOST = 10_000

# A keeper that does not answer is asked again after this time, as long as it is there.
_AGAIN_S = 10.0

# Tokens come from the bus: at most so many recorders are known.
_MOST_KEEPERS = 1_000
_MOST_BESIDE = 100

# Each stream of a robot tells of an outage.
_MOST_OUTAGES = 10_000

# More losses of a link are one gap. So are outages that meet, of a minute together at most: a gap
# is filled after its end.
_MOST_GAPS = 100
_GROWS_BY_NS = 60_000_000_000

_WRITTEN_WITHIN_S = 60.0


@dataclass(eq=False)
class _Gap:
    """A gap between two log times, and how much of it is filled.

    `lost_ns` is when the token was lost (or a pause of ours began), or only messages of `stream`.
    `place` is where its next page begins, `ahead_ns` how far the keeper's clock is ahead of log
    times here.
    """

    from_ns: int
    lost_ns: int
    until_ns: int
    stream: str = ""
    place: str = ""
    ahead_ns: int | None = None
    fill: Fill | None = None
    left_s: float = 0.0
    messages: int = 0
    grows_until_ns: int = 0

    def __post_init__(self) -> None:
        self.grows_until_ns = self.until_ns + _GROWS_BY_NS

    @property
    def noticed_ns(self) -> int:
        """A log time before the loss of the link's streams was noticed."""
        return max(self.from_ns, self.lost_ns - _NOTICED_WITHIN_NS)

    @property
    def share(self) -> float:
        """How much of it is filled, from 0 to 1."""
        whole_s = (self.until_ns - self.from_ns) / 1e9
        return 1.0 - min(self.left_s / whole_s, 1.0) if self.place and whole_s > 0 else 0.0


class _Keeper:
    """A recorder elsewhere that serves its kept messages."""

    def __init__(self, key: str, name: str) -> None:
        self.key = key
        self.name = name
        # The keys of others in the same place: one of them takes it over.
        self.beside: Bounded[str, None] = Bounded(_MOST_BESIDE)
        self.is_there = False
        self.lost_ns: int | None = None
        self.gaps: list[_Gap] = []
        self.asking: AskPages | None = None
        # Whether it is going to be asked.
        self.is_due = False
        self._prefix = name.rpartition("/")[0] + "/"

    def add(self, gap: _Gap) -> bool:
        """Take a gap; whether it is one of its own, and no part of others."""
        # The streams of a robot tell of one outage at slightly different times.
        begins_ns = gap.lost_ns if gap.stream else gap.from_ns
        if any(each.from_ns <= begins_ns and gap.until_ns <= each.until_ns for each in self.gaps):
            return False
        # The first is being asked for, if one is: it stays as it is.
        last = self.gaps[-1] if len(self.gaps) > (self.asking is not None) else None
        # One of which a part has been asked for ends where it was to end then.
        meets = (
            last is not None
            and not last.place
            and gap.lost_ns <= last.until_ns
            and gap.until_ns <= last.grows_until_ns
        )
        if last is not None and (meets or len(self.gaps) >= _MOST_GAPS):
            last.from_ns = min(gap.from_ns, last.from_ns)
            last.lost_ns = min(gap.lost_ns, last.lost_ns)
            last.until_ns = max(gap.until_ns, last.until_ns)
            last.stream = gap.stream if gap.stream == last.stream else ""
            return False
        self.gaps.append(gap)
        return True

    def has(self, name: str, is_here: bool) -> bool:
        """Whether a stream or node is in its namespace, or below; a recorder without a namespace
        has all that are of another host.
        """
        if self._prefix == "/":
            return not is_here
        return f"/{name.removeprefix('/')}".startswith(self._prefix)


class Filling:
    """Watches the recorders that serve their kept messages: once one was out of reach and is back,
    or messages of a stream are missing for a second or more, its messages of that time are written,
    page by page, behind new ones. Until `close()`.
    """

    def __init__(
        self,
        session: Session,
        capture: Capture,
        recorder: Recorder,
        selection: Selection,
        *,
        everywhere: bool,
        log: logging.Logger,
    ) -> None:
        self._session = session
        self._capture = capture
        self._recorder = recorder
        self._wanted = wanted_of(selection)
        self._log = log
        self._once = LogOnce(log)
        self._executor = Executor("filling", log)
        own_pauses().watch(self._executor)
        self._turns = PagesInTurn(self._executor, most=4)
        # By the prefix of their keys: a namespace needs one recorder.
        self._keepers: dict[str, _Keeper] = {}
        # When streams and nodes were lost, their full names, and whether they may be of this host.
        self._lost: deque[tuple[int, str, bool]] = deque(maxlen=_MOST_LOST)
        # From this log time on the messages that come are noted.
        self._noted_from_ns = 0
        capture.on_lost = self._note_lost
        recorder.on_outage = self._note_outage
        key = ALL_KEEPERS_EVERYWHERE if everywhere else ALL_KEEPERS
        self._tokens = session.watch_living(key, self._on_token)

    def close(self) -> None:
        """Fill nothing further. Twice is fine."""
        self._tokens.close()
        self._executor.close()
        for keeper in self._keepers.values():
            if keeper.asking is not None:
                keeper.asking.close()

    def progress(self) -> list[str]:
        """A clause for each recorder whose gap is being filled: `filling /robot7/recorder 42 %`."""
        return [
            f"filling {keeper.name} {100 * gap.share:.0f} %"
            for keeper in list(self._keepers.values())
            for gap in keeper.gaps[:1]  # another thread may end it
        ]

    def unfilled(self) -> list[str]:
        """A clause for each recorder with a gap that is not filled."""
        found = []
        for keeper in list(self._keepers.values()):
            left_s = sum(
                (gap.until_ns - gap.from_ns) / 1e9 * (1 - gap.share) for gap in [*keeper.gaps]
            )
            if not keeper.is_there and keeper.lost_ns is not None:
                left_s += (self._recorder.now_ns() - keeper.lost_ns) / 1e9
            if left_s:
                found.append(f"{duration(left_s)} of {keeper.name} are not filled")
        return found

    # On the executor's thread

    def _note_lost(self, name: str, is_here: bool) -> None:
        now_ns = self._recorder.now_ns()
        self._executor.submit("filling", self._lost.append, (now_ns, name, is_here))

    def _note_outage(self, stream: str, from_ns: int, until_ns: int) -> None:
        self._executor.submit(
            "filling", self._take_outage, stream, from_ns, until_ns, limit=_MOST_OUTAGES
        )

    def _take_outage(self, stream: str, from_ns: int, until_ns: int) -> None:
        """Fill the time in which messages of a stream are missing, though no token was lost."""
        described = self._capture.described.get(stream)
        is_here = described is not None and described.host == socket.gethostname()
        for keeper in self._keepers.values():
            if keeper.is_there and keeper.has(stream, is_here):
                around_ns = from_ns - _OVERLAP_NS, from_ns, until_ns + _OVERLAP_NS
                self._add_gap(keeper, _Gap(*around_ns, stream))
                self._fill_later(keeper, _AFTER_S)
                self._note_received()

    def _on_token(self, key: str, alive: bool) -> None:
        self._executor.submit("filling", self._take_token, key, alive)

    def _take_token(self, key: str, alive: bool) -> None:
        prefix = key.partition("@tfbus/")[0]
        keeper = self._keepers.get(prefix)
        if keeper is None:
            if not alive or not self._has_room():
                return
            keeper = self._keepers[prefix] = _Keeper(key, self._name_of(key))
            self._noted_from_ns = self._noted_from_ns or self._recorder.now_ns()
            self._note_received()
        if keeper.key != key:
            if not alive:
                keeper.beside.pop(key, None)
                return
            if keeper.is_there:
                keeper.beside[key] = None
                return
            keeper.key, keeper.name = key, self._name_of(key)
        if keeper.is_there is alive:
            return
        keeper.is_there = alive
        if not alive:
            # A pause of this process itself, in which it received nothing, belongs to the gap.
            paused_ns = round(own_pauses().since_s() * 1e9)
            keeper.lost_ns = self._recorder.now_ns() - paused_ns
            if keeper.asking is not None:
                keeper.asking.close()
            if keeper.beside:
                other, _ = keeper.beside.popitem(last=False)
                self._take_token(other, True)
        elif keeper.lost_ns is not None:
            lost_ns, now_ns = keeper.lost_ns, self._recorder.now_ns()
            self._add_gap(keeper, _Gap(lost_ns - _BEFORE_NS, lost_ns, now_ns + _OVERLAP_NS))
            keeper.lost_ns = None
            self._fill_later(keeper, _AFTER_S)
        self._note_received()

    def _name_of(self, key: str) -> str:
        name = self._capture.names.full(f"{key.partition('@tfbus/')[0]}{last_name(key)}")
        return f"/{printable(name, 200)}"

    def _has_room(self) -> bool:
        """Whether another keeper can be known; for it one that has left is forgotten."""
        if len(self._keepers) < _MOST_KEEPERS:
            return True
        left = {
            prefix: each.lost_ns
            for prefix, each in self._keepers.items()
            if each.lost_ns is not None and not each.gaps
        }
        if not left:
            self._once.warning("full", "Fill no gaps of more than %d recorders", _MOST_KEEPERS)
            return False
        del self._keepers[min(left, key=left.__getitem__)]
        return True

    def _add_gap(self, keeper: _Keeper, gap: _Gap) -> None:
        gap.from_ns = max(gap.from_ns, self._noted_from_ns)
        if not keeper.add(gap):
            return
        length = duration((gap.until_ns - _OVERLAP_NS - gap.lost_ns) / 1e9)
        if gap.stream:
            self._log.info(
                "Messages of stream %r are missing for %s: what %s has kept of that is filled in",
                gap.stream,
                length,
                keeper.name,
            )
            return
        self._log.info(
            "%s was out of reach for %s: what it has kept of that is filled in",
            keeper.name,
            length,
        )

    def _note_received(self) -> None:
        held = any(each.gaps or each.lost_ns is not None for each in self._keepers.values())
        self._recorder.notice_received(held=held)

    def _fill_later(self, keeper: _Keeper, after_s: float) -> None:
        if keeper.is_due:
            return

        def fill() -> None:
            keeper.is_due = False
            self._fill(keeper)

        keeper.is_due = True
        self._executor.after(after_s, fill)

    def _fill(self, keeper: _Keeper) -> None:
        """Ask for the first gap, unless that is done already, or once its end is on the disk."""
        if keeper.asking is not None or not keeper.gaps or not keeper.is_there:
            return
        gap = keeper.gaps[0]
        ended_s = (self._recorder.now_ns() - gap.until_ns + _OVERLAP_NS) / 1e9
        if ended_s < _AFTER_S:
            self._fill_later(keeper, _AFTER_S - ended_s)
            return
        asking = keeper.asking = _AskGap(self, keeper, gap)
        asking.start()

    def _again_ns(self, keeper: _Keeper) -> int:
        """The log time at which a later gap of a keeper begins, at the earliest."""
        next_ns = self._recorder.now_ns() if keeper.lost_ns is None else keeper.lost_ns
        return min([next_ns - _BEFORE_NS, *(gap.from_ns for gap in keeper.gaps[1:])])

    def _take_written(
        self, keeper: _Keeper, gap: _Gap, page: Page, written: "Future[object]"
    ) -> bool:
        """Wait until a page is written, and go on behind it; False if it could not be."""
        try:
            filled = written.result(_WRITTEN_WITHIN_S)
        except (TfbusError, TimeoutError, OSError) as error:
            self._once.warning(
                (keeper.name, type(error)),
                "Could not write what came of %s, it is asked for again: %s",
                keeper.name,
                error or "the disk is too slow",
            )
            return False
        assert isinstance(filled, Filled)
        gap.fill = filled.fill
        gap.place, gap.left_s = page.next, page.left_s
        gap.messages += sum(not isinstance(item, EventItem) for item in filled.items)
        return True

    def _end_gap(self, keeper: _Keeper, gap: _Gap) -> None:
        length = duration((gap.until_ns - _OVERLAP_NS - gap.lost_ns) / 1e9)
        self._log.info(
            "Filled the %s without %s: %s",
            length,
            f"stream {gap.stream!r}" if gap.stream else keeper.name,
            counted(gap.messages, "message"),
        )
        facts = {
            "until": gap.until_ns,
            "messages": gap.messages,
            "lost": sorted(
                {
                    name
                    for lost_ns, name, is_here in self._lost
                    if gap.noticed_ns <= lost_ns <= gap.until_ns and keeper.has(name, is_here)
                }
            ),
        }
        event = EventItem(0, "filled", keeper.name, facts)
        self._recorder.fill([Raw(gap.noticed_ns, EVENTS, event)], gap.fill, gap.until_ns)
        self._note_received()

    def _raws(self, messages: Sequence[KeptMessage], gap: _Gap) -> list[Raw]:
        """The messages of a page that the recorder takes, as it takes them."""
        lost = {name for lost_ns, name, _ in self._lost if lost_ns >= gap.noticed_ns}
        found = []
        for message in messages:
            log_ns = max(message.log_ns - (gap.ahead_ns or 0), 0)
            if log_ns < self._noted_from_ns:
                continue
            if not gap.from_ns - _BEFORE_NS <= log_ns <= gap.until_ns + _BEFORE_NS:
                self._once.warning("time", "Left out a message that was kept of another time")
                continue
            with suppress(DecodeError):
                if (raw := self._raw(message, log_ns, lost)) is not None:
                    found.append(raw)
        return found

    def _raw(self, message: KeptMessage, log_ns: int, lost: set[str]) -> Raw | None:
        key, payload = message.key, message.payload
        if key.startswith((STREAM, NODE)):
            kind: Literal["stream", "node"] = "stream" if key.startswith(STREAM) else "node"
            name = last_name(key)
            if name not in lost and self._capture.knows(name):
                return None  # it was there all the time
            if not payload:
                gone: EventKind = "stream gone" if kind == "stream" else "node gone"
                return Raw(log_ns, EVENTS, EventItem(0, gone, name, {"filled": True}))
            facts = self._capture.late_facts(kind, name, payload)
            return Raw(log_ns, EVENTS, EventItem(0, kind, name, facts))
        own = relative(f"/{key}", self._session.settings.namespace)
        source = None if own.startswith("/") else self._capture.late_source(own)
        return None if source is None else Raw(log_ns, source, payload)


class _AskGap(AskPages):
    """Asks a recorder for its messages of a gap, each page once the one before is written."""

    def __init__(self, filling: Filling, keeper: _Keeper, gap: _Gap) -> None:
        super().__init__(
            filling._session,
            filling._executor,
            filling._turns,
            place=gap.place,
            payload=filling._wanted,
        )
        self._filling = filling
        self._keeper = keeper
        self._gap = gap
        self._written: list[tuple[Page, Future[object]]] = []
        self._asked_ns = 0

    def selector(self) -> str:
        if not self._take_written():
            self.close()
            raise BusError("a page could not be written")
        now_ns = self._asked_ns = self._filling._recorder.now_ns()
        from_s, until_s = (
            (now_ns - each) / 1e9 for each in (self._gap.from_ns, self._gap.until_ns)
        )
        return kept_selector(self._keeper.key, from_s, max(until_s, 0.0))

    def on_page(self, page: Page) -> None:
        filling, keeper, gap = self._filling, self._keeper, self._gap
        if gap.ahead_ns is None:
            # The page waits for a narrow link, and messages of now wait for less.
            then_ns = (self._asked_ns + filling._recorder.now_ns()) // 2
            gap.ahead_ns = page.now_ns - then_ns if page.now_ns else 0
        raws = filling._raws(page.messages, gap)
        filled = filling._recorder.fill(raws, gap.fill, filling._again_ns(keeper))
        self._written.append((page, filled))

    def on_over(self) -> None:
        self._filling._executor.submit("filling", self._end)

    def _end(self) -> None:
        filling, keeper, gap = self._filling, self._keeper, self._gap
        is_written = self._take_written()
        keeper.asking = None
        if self.is_complete and is_written:
            keeper.gaps.remove(gap)
            filling._end_gap(keeper, gap)
            filling._fill(keeper)
        elif keeper.is_there:
            filling._fill_later(keeper, _AGAIN_S)

    def _take_written(self) -> bool:
        """Wait until what has come is written; False if it could not be."""
        filling, keeper, gap = self._filling, self._keeper, self._gap
        return all(
            filling._take_written(keeper, gap, *self._written.pop()) for _ in [*self._written]
        )
