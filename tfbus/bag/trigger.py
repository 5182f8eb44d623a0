"""Conditions on which a recorder writes a snapshot, `gone base_link`; names that nothing has."""

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field

from tfbus.errors import DecodeError, InvalidArgumentException
from tfbus.listen.conflicts import Claims
from tfbus.recording.items import EventItem
from tfbus.recording.selection import Selection
from tfbus.wire.codec import from_map
from tfbus.wire.descriptions import StreamDescription
from tfbus.wire.fleet import FrameNames, has_name
from tfbus.wire.keys import namespace_of_node
from tfbus.wording import did_you_mean, listed, printable

_KINDS = ("gone", "conflict")


@dataclass(frozen=True)
class Condition:
    """A frame's publisher is gone, or two publishers send it; "" is any frame."""

    kind: str
    frame: str = ""

    @classmethod
    def parse(cls, text: str) -> "Condition":
        """The condition in `gone base_link`. Raises InvalidArgumentException."""
        kind, _, frame = text.strip().partition(" ")
        if kind not in _KINDS:
            raise InvalidArgumentException(
                f"'{printable(text, 60)}' is no condition: write 'gone FRAME' or 'conflict FRAME'; "
                "without FRAME it holds for any"
            )
        return cls(kind, frame.strip())

    def __str__(self) -> str:
        return f"{self.kind} {self.frame}".strip()


@dataclass
class Triggers:
    """Finds in the events of streams what fulfils one of some conditions. Their frames have the
    names of the robot, or those in a fleet: `base_link`, `robot7/base_link`.
    """

    conditions: tuple[Condition, ...]
    _claims: Claims = field(default_factory=lambda: Claims("latest"))
    # Of each stream its namespace and child frames, as they are called in a fleet.
    _frames: dict[str, tuple[FrameNames, list[str]]] = field(default_factory=dict)

    def fulfilled_by(self, event: EventItem) -> str:
        """What the event says that a condition asks for, as a sentence; "" for nothing."""
        if event.kind == "stream":
            return self._conflict(event)
        if event.kind != "stream gone":
            return ""
        self._claims.update(event.name, None)
        names, children = self._frames.pop(event.name, (FrameNames(""), []))
        frames = self._wanted("gone", names, children)
        return f"stream {event.name!r} is gone, with {listed(frames, most=3)}" if frames else ""

    def _conflict(self, event: EventItem) -> str:
        try:
            description = from_map(StreamDescription, event.facts)
        except DecodeError:
            return ""
        # Two robots may have frames of one name.
        names = FrameNames(namespace_of_node(description.node))
        description = names.description_outside(description)
        self._frames[event.name] = names, [child for _, child, _ in description.frames]
        contested = self._claims.update(event.name, description)
        for conflict in self._claims.news(event.name, contested):
            if frames := self._wanted("conflict", names, conflict.frames):
                streams = f"{conflict.first.stream!r} and {conflict.other.stream!r}"
                return f"streams {streams} both send {listed(frames, most=3)}"
        return ""

    def _wanted(self, kind: str, names: FrameNames, frames: Iterable[str]) -> list[str]:
        wanted = [each.frame for each in self.conditions if each.kind == kind]
        return [
            frame
            for frame in frames
            for own in [frame.removeprefix(f"{names.namespace}/")]
            if any(not name or has_name(own, names.namespace, name) for name in wanted)
        ]


def unmatched(
    selection: Selection,
    conditions: Collection[Condition],
    described: Mapping[str, StreamDescription],
    received: Collection[str],
) -> Iterator[str]:
    """A clause for each stream and frame that is asked for and that nothing is called; `described`
    are the streams that there were, `received` those of which messages came. A frame may come in a
    stream without a description: then nothing is said.
    """
    known = {*described, *received}
    for name in selection.streams:
        if name not in known:
            yield f"no stream is called '{printable(name, 60)}'{did_you_mean(name, known)}"
    if set(received) - set(described):
        return
    frames = {
        (namespace_of_node(each.node), child)
        for each in described.values()
        for _, child, _ in each.frames
    }
    in_fleet = {FrameNames(namespace).outside(child) for namespace, child in frames}
    asked = [*selection.frames, *(each.frame for each in conditions if each.frame)]
    for name in dict.fromkeys(asked):
        if not any(has_name(child, namespace, name) for namespace, child in frames):
            yield f"no frame is called '{printable(name, 60)}'{did_you_mean(name, in_fleet)}"
