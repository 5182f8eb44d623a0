"""The end of a link in one session: declarations of the far end, and the lane to it."""

import itertools
from collections import Counter
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

from tfbus.testing.declarations import KINDS, QUERYABLE
from tfbus.testing.keys import Keys
from tfbus.testing.links import Lane

if TYPE_CHECKING:
    from tfbus.testing.queries import Asked
    from tfbus.testing.zenoh_session import ZenohSession

_numbers = itertools.count()


class Face:
    """The end of a link in one session."""

    def __init__(self, session: "ZenohSession", lane: Lane) -> None:
        self.session = session
        self.lane = lane
        # Later ones have larger numbers.
        self.number = next(_numbers)
        self.far: Face
        self.is_open = True
        self._has_lost = False
        # Declarations of the far end, by kind.
        self.declared = {kind: Keys() for kind in KINDS}
        # How often the far end was told of a declaration, by kind and key.
        self._told: dict[str, Counter[str]] = {kind: Counter() for kind in KINDS}
        # The queries that went out by it and have not ended.
        self.asked: dict[int, Asked] = {}

    @property
    def far_session(self) -> "ZenohSession":
        """The session at its far end."""
        return self.far.session

    def wants(self, kind: str, key: str) -> bool:
        """Whether the far end has declared something of this kind that a key meets."""
        return self.declared[kind].meets(key)

    def continue_of(self, former: "Face") -> None:
        """Take over all that a former end knew and told: a link was added to it."""
        self.declared, self._told, self.asked = former.declared, former._told, former.asked
        self.session.declarations.move(former, self)

    def send(
        self, call: Callable[["Face"], object], size: int = 100, *, is_urgent: bool = True
    ) -> None:
        """Make `call(far end)` there, in the order of the calls that are as urgent."""
        far = self.far

        def arrive() -> None:
            if far.is_open:
                call(far)

        self.lane.send(lambda: far.session.process.receive(arrive), size, is_urgent=is_urgent)

    def tell(self, kind: str, key: str, change: int) -> None:
        """Count a declaration more, or less: the far end hears of the first and of the last."""
        if self._is_news(kind, key, change):
            self._send_news([(kind, key)], change > 0)

    def tell_all(self, declared: Iterable[tuple[str, str]]) -> None:
        """Tell of all that is declared on a new link. It goes out in two messages, so that the far
        end may have done something after any of it, and before the next.
        """
        news = [(kind, key) for kind, key in declared if self._is_news(kind, key, 1)]
        cut = int(self.session.tasks.random.random() * (len(news) + 1))
        for part in (news[:cut], news[cut:]):
            if part:
                self._send_news(part, True)

    def _is_news(self, kind: str, key: str, change: int) -> bool:
        """Count a declaration more, or less; whether the far end has to hear of it."""
        told = self._told[kind]
        former = told[key]
        told[key] += change
        if told[key] == 0:
            del told[key]
        if former == 0:
            if kind == QUERYABLE and not self._has_lost and self.session.fabric.loses_declaration():
                # More than one of a link was never seen to be lost.
                self._has_lost = True
                return False
            return True
        return key not in told

    def _send_news(self, news: list[tuple[str, str]], is_new: bool) -> None:
        def hear(far: "Face") -> None:
            for kind, key in news:
                far.session.declarations.hear(far, kind, key, is_new)

        self.send(hear, 100 * len(news))
