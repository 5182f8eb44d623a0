"""Which streams there are: by their liveliness tokens and descriptions, without their data."""

import logging
import threading
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, replace

from tfbus.codec import decode_message
from tfbus.description import StreamDescription
from tfbus.errors import DecodeError
from tfbus.keys import ALL_STREAMS, ALL_STREAMS_EVERYWHERE, stream_of
from tfbus.retained import declare_retained_subscriber
from tfbus.session import Session

# Streams come and go; of those that have gone so many of the last are remembered.
MOST_GONE = 1000


@dataclass(frozen=True)
class StreamState:
    """A stream as it is now.

    `name` is as `stream_of` gives it: `sim`, or `robot7/sim` outside of the namespace. `alive`
    is whether its publisher is there. `description` is the last it has sent, None before the
    first. `key` is where its token and its description are.
    """

    name: str
    alive: bool = False
    description: StreamDescription | None = None
    key: str = ""


class StreamWatch:
    """Knows at any time which streams there are; closed by `close()` or the session's end.

    `on_change(state)` is called after each change of one stream, one call at a time, on threads
    of Zenoh's. With `everywhere` the streams of all namespaces below are watched. Descriptions
    that cannot be read are counted in `rejected` by their stream, and the first is logged.
    """

    def __init__(
        self,
        session: Session,
        on_change: Callable[[StreamState], None],
        *,
        everywhere: bool = False,
        log: logging.Logger | None = None,
    ) -> None:
        self.rejected: Counter[str] = Counter()
        self._on_change = on_change
        self._log = log
        self._states: dict[str, StreamState] = {}
        self._gone: dict[str, None] = {}
        self._turns = _Turns()
        key = ALL_STREAMS_EVERYWHERE if everywhere else ALL_STREAMS
        self._descriptions = declare_retained_subscriber(session, key, self._on_description)
        self._tokens = session.watch_living(key, self._on_token)

    def streams(self) -> dict[str, StreamState]:
        """All streams by their names, and of those that have gone the last thousand."""
        return dict(self._states)

    def close(self) -> None:
        """Watch no more. Twice is fine."""
        self._tokens.close()
        self._descriptions.close()

    def _on_token(self, key: str, alive: bool) -> None:
        self._turns.take(lambda: self._update(key, alive=alive))

    def _on_description(self, key: str, payload: bytes) -> None:
        try:
            description = decode_message(StreamDescription, payload)
        except DecodeError as error:
            self._reject(stream_of(key), error)
        else:
            self._turns.take(lambda: self._update(key, description=description))

    def _update(self, key: str, **changed: object) -> None:
        name = stream_of(key)
        former = self._states.get(name) or StreamState(name, key=key)
        state = replace(former, **changed)  # type: ignore[arg-type]  # fields of StreamState
        if state == former and name in self._states:
            return
        self._states[name] = state
        self._gone.pop(name, None)
        if not state.alive:
            self._remember_as_gone(name)
        self._on_change(state)

    def _remember_as_gone(self, name: str) -> None:
        self._gone[name] = None
        if len(self._gone) > MOST_GONE:
            oldest = next(iter(self._gone))
            del self._gone[oldest], self._states[oldest]

    def _reject(self, stream: str, error: DecodeError) -> None:
        first = not self.rejected
        self.rejected[stream if stream in self._states else ""] += 1
        if first and self._log is not None:
            self._log.warning(
                "Dropped the description of stream %r: %s. More of them are only counted",
                stream,
                error,
            )


class _Turns:
    """Does jobs one at a time, in the order they come, and makes nobody wait.

    Who finds it busy leaves his job to the one who is at it. So a job may lead to another, and
    may run into any lock of who brought it.
    """

    def __init__(self) -> None:
        self._jobs: deque[Callable[[], None]] = deque()
        self._busy = threading.Lock()

    def take(self, job: Callable[[], None]) -> None:
        """Do the job now, or have it done by who is at it."""
        self._jobs.append(job)
        while self._jobs and self._busy.acquire(blocking=False):
            try:
                if self._jobs:
                    self._jobs.popleft()()
            finally:
                self._busy.release()
