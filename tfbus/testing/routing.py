"""The ways of messages and declarations from a session: peers and clients pass nothing on."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from tfbus.testing.keys import Keys

if TYPE_CHECKING:
    from tfbus.testing.faces import Face
    from tfbus.testing.zenoh_session import ZenohSession


class Way(NamedTuple):
    """A face by which a message goes on, and its journey from there."""

    face: "Face"
    journey: "Journey"


@dataclass(frozen=True)
class Journey:
    """The journey of a message: its first router, and all routers that it crossed."""

    root: str = ""
    crossed: frozenset[str] = frozenset()


class Direct:
    """The routing of peers and clients: they pass nothing on."""

    def __init__(self, session: "ZenohSession") -> None:
        self._session = session

    def spread(self, source: object, kind: str, key: str, change: int) -> None:
        """Tell others of a declaration of the session itself."""
        if source is self._session:
            for face in self._session.faces.values():
                face.tell(kind, key, change)

    def sources(self) -> Iterator[tuple[object, dict[str, Keys]]]:
        """All sources of declarations, and what is declared there."""
        own = self._session.declarations.own
        yield self._session, {kind: Keys(keys) for kind, keys in own.items()}
        for face in self._session.faces.values():
            yield face, face.declared

    def has(self, kind: str, full: str) -> bool:
        """Whether a declaration of another session meets a key."""
        return bool(self._session.declarations.heard[kind].met_by(full))

    def ways(
        self, kind: str, full: str, journey: Journey | None = None, came_by: "Face | None" = None
    ) -> list[Way]:
        """The faces by which a message goes on; without `journey` it is of this session."""
        if came_by is not None:
            return []
        faces = self._session.declarations.heard[kind].met_by(full)
        return [Way(face, Journey()) for face in faces if face.is_open]

    def greet(self, face: "Face") -> None:
        """Tell the far end of a new face all that it has to know."""
        own = self._session.declarations.own
        face.tell_all((kind, key) for kind, keys in own.items() for key in keys)

    def part(self, face: "Face") -> None:
        """A face has ended."""
