"""Publishers of payloads: one of a key, or thousands that share what one of them knows."""

from typing import Any

import zenoh

from tfbus.bus.handles import Declaration, HeardWatch
from tfbus.bus.zenoh_errors import as_bus_error


def priority_of(urgent: bool) -> zenoh.Priority:
    """What is urgent goes before the rest."""
    return zenoh.Priority.INTERACTIVE_HIGH if urgent else zenoh.Priority.DATA


class BytesPublisher(Declaration):
    """Sends payloads on one key; made by a session or, for retained ones, by tfbus.bus.retained."""

    def __init__(self, key: str, publisher: Any):
        super().__init__(publisher)
        self._key = key

    @property
    def heard(self) -> bool:
        """Whether somebody subscribes to its key now."""
        status: Any = self._declared.matching_status  # a bool in Zenoh's stubs, but not in Zenoh
        return bool(status.matching)

    def put(self, payload: bytes) -> None:
        """Send one payload. Raises BusError where the session is closed."""
        try:
            self._declared.put(payload)
        except zenoh.ZError as error:
            raise as_bus_error(f"publish {self._key}", error) from error


class PublishersWithin:
    """Makes publishers by the thousand.

    Zenoh's own take a time that grows with the square of their number: 10,000 took 3 s. These
    share one of them, which knows whether anybody hears any of the keys.
    """

    def __init__(self, session: zenoh.Session, heard: HeardWatch, priority: zenoh.Priority):
        self._session = session
        self._heard = heard
        self._priority = priority

    @property
    def heard(self) -> bool:
        """Whether somebody subscribes to any of the keys now."""
        return self._heard.heard

    def publisher(self, key: str) -> BytesPublisher:
        """A publisher of one key."""
        return BytesPublisher(key, _OneOfMany(self._session, self._heard, key, self._priority))


class _OneOfMany:
    """Stands in for a publisher of Zenoh's."""

    def __init__(
        self, session: zenoh.Session, heard: HeardWatch, key: str, priority: zenoh.Priority
    ):
        self._session = session
        self._heard = heard
        self._key = zenoh.KeyExpr(key)
        self._priority = priority

    def put(self, payload: bytes) -> None:
        if self._heard.heard or self._session.is_closed():
            self._session.put(
                self._key,
                payload,
                congestion_control=zenoh.CongestionControl.DROP,
                priority=self._priority,
            )

    def undeclare(self) -> None:
        """There is nothing of its own to end."""
