"""Two living publishers of one frame: it is told, and the rule decides whose transforms count."""

import logging
from collections.abc import Mapping

from tfbus.buffer.buffer import Buffer
from tfbus.buffer.info import Change
from tfbus.listen.claims import Claims, Conflict, Rule, name_some
from tfbus.listen.reception import StreamReception
from tfbus.wire.descriptions import StreamDescription


class Conflicts:
    """Lets of the streams that claim a frame the right one through.

    `streams` are those that are received, by name. Used by one thread at a time.
    """

    def __init__(
        self,
        rule: Rule,
        buffer: Buffer,
        streams: Mapping[str, StreamReception],
        log: logging.Logger,
    ) -> None:
        self._claims = Claims(rule)
        self._buffer = buffer
        self._streams = streams
        self._log = log

    def judge(self, name: str, description: StreamDescription | None) -> None:
        """Take what a stream claims now; None where its publisher is not there."""
        contested = self._claims.update(name, description)
        if not contested:
            return
        for conflict in self._claims.news(contested):
            self._tell(conflict)
        frames = () if description is None else description.frames
        left = contested - {child for _, child, _ in frames}
        rulings = self._claims.rulings(name, contested)
        changed = [self._streams[each].exclude(ruling) for each, ruling in rulings.items()]
        # A static transform that comes into its right, or that another has lain over, is not sent
        # again.
        for each, ruling in rulings.items():
            won = ruling.won if any(changed) else ruling.won & left
            self._streams[each].apply_statics(won - left if each == name else won)

    def restore(self, name: str, frames: frozenset[str]) -> None:
        """Put back the static transforms of those who have the right of way of these frames, which
        a stream has laid its own over since.
        """
        for each, ruling in self._claims.rulings(name, frames).items():
            if each != name:
                self._streams[each].apply_statics(ruling.won)

    def _tell(self, conflict: Conflict) -> None:
        first, other, rule = conflict.first, conflict.other, self._claims.rule
        wins = {
            "latest": "whoever sent last wins",
            "first": f"{first.stream!r} wins, as it was started first",
            "priority": f"{first.stream!r} wins, by its priority or as it was started first",
        }
        self._log.warning(
            "Two publishers send %s: stream %s, and stream %s; %s (conflicts=%r). Stop one of "
            "them, or give its frame another name",
            name_some(conflict.frames),
            first,
            other,
            wins[rule],
            rule,
        )
        for child in conflict.frames:
            parents = other.parent_of(child), first.parent_of(child)
            change = Change("conflict", child, *parents, other.stream, first.stream, 0)
            self._buffer.tell(change)
