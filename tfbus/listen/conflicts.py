"""Two live publishers of one frame: reports it, and accepts transforms by the rule."""

import logging
from collections.abc import Callable, Iterable

from tfbus.buffer.buffer import Buffer
from tfbus.buffer.info import Change
from tfbus.listen.claims import Claims, Conflict, Rule, listed_children, name_some
from tfbus.listen.reception import StreamReception, lines_of
from tfbus.wire.descriptions import StreamDescription


class Conflicts:
    """Decides whose transforms of a frame are taken if several streams list it.

    `reception(name)` is that of a stream, None if it has been forgotten. Not safe from several
    threads at once.
    """

    def __init__(
        self,
        rule: Rule,
        buffer: Buffer,
        reception: Callable[[str], StreamReception | None],
        log: logging.Logger,
    ) -> None:
        self._claims = Claims(rule)
        self._buffer = buffer
        self._reception = reception
        self._lines = lines_of(log)

    def judge(self, name: str, description: StreamDescription | None) -> None:
        """Take the frames that a stream lists now; None if its publisher is gone."""
        contested = self._claims.update(name, description)
        frames = listed_children(description)
        self._take_back(name, frames)
        if not contested:
            return
        for conflict in self._claims.news(name, contested):
            self._report(conflict)
        left = contested - frames
        resolutions = self._claims.resolutions(name, contested)
        receptions = self._known(resolutions)
        changed = [each.exclude(resolutions[each.name]) for each in receptions]
        # A static transform that gets priority, or that another has replaced, is not sent again.
        for each in receptions:
            accepted = resolutions[each.name].accepted
            taken = accepted if any(changed) else accepted & left
            each.apply_statics(taken - left if each.name == name else taken)

    def _known(self, names: Iterable[str]) -> list[StreamReception]:
        """The receptions of the streams of these names, without those that have been forgotten."""
        receptions = map(self._reception, names)
        return [reception for reception in receptions if reception is not None]

    def _take_back(self, name: str, frames: frozenset[str]) -> None:
        """Take the frames that a stream lists from those that do not list them."""
        senders = self._buffer.senders_of(frames)
        for stream in self._known([name]):
            for sender in self._known(sorted(senders.keys() - {name})):
                unlisted = senders[sender.name] - sender.listing.children
                if unlisted:
                    stream.inherit(unlisted, sender.name)
                    stream.apply_statics(unlisted)

    def claimed_by_others(self, name: str, children: frozenset[str]) -> frozenset[str]:
        """Which of these frames other live streams list. Safe from any thread."""
        return self._claims.of_others(name, children)

    def restore(self, name: str, frames: frozenset[str]) -> None:
        """Put back the static transforms of the streams with priority for these frames, which the
        stream of this name has replaced since, or removed.
        """
        resolutions = self._claims.resolutions(name, frames)
        listed = [each.listing.children for each in self._known([name])]
        for each in self._known(each for each in resolutions if each != name):
            accepted = resolutions[each.name].accepted
            each.inherit(accepted.difference(*listed), name)
            each.apply_statics(accepted)

    def _report(self, conflict: Conflict) -> None:
        first, other, rule = conflict.first, conflict.other, self._claims.rule
        wins = {
            "latest": "the last to send wins",
            "first": f"{first.stream!r} wins, since it was started first",
            "priority": f"{first.stream!r} wins, by its priority or since it was started first",
        }
        self._lines.warning(
            (first.stream, other.stream),
            "Two publishers send %s: stream %s, and stream %s; %s (conflicts=%r). Stop one, or "
            "rename its frame",
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
