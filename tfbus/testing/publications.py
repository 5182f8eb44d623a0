"""Publications of a session: its subscribers, and messages in and out.

A congested link drops a message, or makes its publisher wait, as the message asks for.
"""

import itertools
from functools import partial
from typing import TYPE_CHECKING

from tfbus.testing.callers import Handler, guarded
from tfbus.testing.declarations import SUBSCRIBER, Declared
from tfbus.testing.keys import intersect
from tfbus.testing.messages import Sample, Source
from tfbus.testing.routing import Journey

if TYPE_CHECKING:
    from tfbus.testing.faces import Face
    from tfbus.testing.zenoh_session import ZenohSession

# A message that must not be dropped closes a link that takes nothing for this long.
_CLOSE_AFTER_S = 5.0
_LOOK_FOR_ROOM_S = 0.005

# Bytes around a payload.
_AROUND = 60


class Message:
    """A message on its way: `must_arrive` if it waits for room on a link."""

    def __init__(
        self, full: str, data: bytes, source: Source | None, *, must_arrive: bool, is_urgent: bool
    ) -> None:
        self.full = full
        self.data = data
        self.source = source
        self.must_arrive = must_arrive
        self.is_urgent = is_urgent


class _Subscriber:
    def __init__(self, full: str, handler: Handler, is_remote_only: bool) -> None:
        self.full = full
        self.handler = handler
        self.is_remote_only = is_remote_only


class Publications:
    """Subscribers of one session, and the messages that it sends and gets."""

    def __init__(self, session: "ZenohSession") -> None:
        self._session = session
        self._numbers = itertools.count(1)
        self._subscribers: dict[int, _Subscriber] = {}
        # Those that a key meets, until one comes or goes.
        self._met: dict[str, list[_Subscriber]] = {}

    def subscribe(self, full: str, handler: Handler, *, is_remote_only: bool) -> Declared:
        """Call the handler for each message that meets a key."""
        number = next(self._numbers)
        self._subscribers[number] = _Subscriber(full, handler, is_remote_only)
        self._met.clear()
        declarations = self._session.declarations
        declarations.change(SUBSCRIBER, full, 1)

        def undeclare() -> None:
            if self._subscribers.pop(number, None):
                self._met.clear()
                declarations.change(SUBSCRIBER, full, -1)

        return Declared(self._session, undeclare)

    def clear(self) -> None:
        """Hear nothing more."""
        self._subscribers.clear()
        self._met.clear()

    def _of(self, full: str) -> list[_Subscriber]:
        """The subscribers that a key meets, in the order of their declarations."""
        found = self._met.get(full)
        if found is None:
            found = [each for each in self._subscribers.values() if intersect(each.full, full)]
            self._met[full] = found
        return found

    def send(self, message: Message, *, also_here: bool) -> None:
        """Send a message of this session; waits for room if it must arrive."""
        if also_here:
            self._deliver(message, is_remote=False)
        for face, journey in self._session.routing.ways(SUBSCRIBER, message.full):
            if face.is_open and self._has_room(face, message):
                self._pass_on(face, message, journey)

    def receive(self, face: "Face", message: Message, journey: Journey) -> None:
        """A message comes in by a face: routers pass it on."""
        session = self._session
        for way, onwards in session.routing.ways(SUBSCRIBER, message.full, journey, face):
            if way.lane.has_room(message.is_urgent):
                self._pass_on(way, message, onwards)
            else:
                session.fabric.dropped += 1
        if self._of(message.full):
            session.callers.post(face, lambda: self._deliver(message, is_remote=True))

    def _pass_on(self, face: "Face", message: Message, journey: Journey) -> None:
        size = len(message.data) + _AROUND

        def receive(far: "Face") -> None:
            far.session.publications.receive(far, message, journey)

        face.send(receive, size, is_urgent=message.is_urgent)

    def _has_room(self, face: "Face", message: Message) -> bool:
        """Whether a link takes a message, after a wait if it must arrive."""
        session = self._session
        if face.lane.has_room(message.is_urgent):
            return True
        if not message.must_arrive:
            session.fabric.dropped += 1
            return False
        waited_s = 0.0
        while not face.lane.has_room(message.is_urgent) and face.is_open:
            session.tasks.wait("room on a link", _LOOK_FOR_ROOM_S)
            waited_s += _LOOK_FOR_ROOM_S
            if waited_s > _CLOSE_AFTER_S:
                session.fabric.lose(face)
                return False
        return True

    def _deliver(self, message: Message, *, is_remote: bool) -> None:
        seen = self._session.names.seen(message.full)
        if seen is None:
            return
        for subscriber in self._of(message.full):
            if is_remote or not subscriber.is_remote_only:
                sample = Sample(seen, message.data, source=message.source)
                guarded(partial(subscriber.handler.call, sample))
