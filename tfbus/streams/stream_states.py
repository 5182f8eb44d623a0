"""The states of the streams on the bus, and the descriptions that cannot be read."""

from collections import Counter
from collections.abc import Callable

from tfbus.base import scheduler
from tfbus.base.bounded import Bounded
from tfbus.base.errors import DecodeError
from tfbus.base.log import LogOnce
from tfbus.base.structs import replace
from tfbus.base.wording import is_printable, printable
from tfbus.streams.frame_names import StreamRights
from tfbus.streams.info import MOST_GONE, StreamState
from tfbus.wire.descriptions import StreamDescription, read_description
from tfbus.wire.keys import stream_of


class StreamStates:
    """The states of streams by their names, the last thousand gone ones among them.

    `on_change(state)` is called after each `change`, and `on_forgotten(state)` after a stream that
    is long gone was forgotten. Descriptions are read by the `rights` of a closed bus, if there are
    any. All but `read` and `is_name` runs on the watch's thread.
    """

    def __init__(
        self,
        once: LogOnce,
        rights: StreamRights | None,
        on_change: Callable[[StreamState], object],
        on_forgotten: Callable[[StreamState], object],
    ) -> None:
        self.once = once
        self._rights = rights
        self._on_change = on_change
        self._on_forgotten = on_forgotten
        # How many descriptions were rejected, by their stream; "" for streams that are not known.
        self.rejected: Counter[str] = Counter()
        self._states: dict[str, StreamState] = {}
        # Taken for each change of both: Zenoh's threads read descriptions.
        self._lock = scheduler.Lock()
        self._gone: Bounded[str, None] = Bounded(MOST_GONE, lambda name, _: self._forget(name))
        # When the tokens came that are back, and whose descriptions are not there so far.
        self.returning: dict[str, float] = {}
        self.is_closed = False

    def as_dict(self) -> dict[str, StreamState]:
        """All of them by their names."""
        return dict(self._states)

    def known(self, name: str) -> StreamState | None:
        """The state of the stream of this name; None if it has none so far."""
        return self._states.get(name)

    def of(self, key: str) -> StreamState:
        """The state of the stream of this token; a new one if it has none so far."""
        name = stream_of(key)
        return self._states.get(name) or StreamState(name, key=key)

    def store(self, state: StreamState) -> None:
        """Store a state without a report."""
        with self._lock:
            self._states[state.name] = state

    def change(self, state: StreamState) -> None:
        """Store a state and report it, if it is another."""
        with self._lock:
            if state == self._states.get(state.name):
                return
            self._states[state.name] = state
        self._gone.pop(state.name, None)
        if not state.alive:
            self._gone[state.name] = None
        self._on_change(state)

    def take_back(self, key: str) -> None:
        """No description comes from a stream that is back: the last one stands."""
        former = self.of(key)
        if former.name in self.returning:
            del self.returning[former.name]
            self.change(replace(former, alive=True))

    def _forget(self, name: str) -> None:
        with self._lock:
            state = self._states.pop(name)
            self.rejected.pop(name, None)
        self._on_forgotten(state)

    def is_name(self, key: str) -> bool:
        """Whether the name of the stream of this token can be shown; logged if it cannot."""
        name = stream_of(key)
        if is_printable(name):
            return True
        self.once.warning("name", "Ignored a stream: its name %r cannot be shown", name[:300])
        return False

    def read(self, key: str, payload: bytes) -> StreamDescription | None:
        """Read a description as far as the stream may say it; None if it is unreadable."""
        name = stream_of(key)
        try:
            description, mistake = read_description(payload)
        except DecodeError as error:
            self.reject(name, error)
            why = printable(str(error))
            with self._lock:
                if state := self._states.get(name):
                    self._states[name] = replace(state, unreadable=why)
            return None
        if mistake:
            self.once.warning(("frame", name), "Ignored a frame of stream %r: it %s", name, mistake)
        if self._rights is None:
            return description
        allowed, mistake = self._rights.checked(key, description)
        if mistake:
            self.once.warning(
                ("rights", name),
                "Refused what stream %r says of itself: it %s, by the rights of this bus",
                name,
                mistake,
            )
        return allowed

    def reject(self, stream: str, error: DecodeError | str) -> None:
        """Count a description that is not taken, and log the first."""
        with self._lock:
            self.rejected[stream if stream in self._states else ""] += 1
        self.once.warning(
            ("rejected", stream), "Dropped the description of stream %r: %s", stream, error
        )
