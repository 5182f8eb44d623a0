"""Messages of transforms as they come, with the names of frames that have numbers in them."""

from collections import deque
from collections.abc import Callable

from tfbus.listen.info import StreamState
from tfbus.listen.watch import StreamWatch
from tfbus.node.node import Node
from tfbus.runtime import scheduler
from tfbus.runtime.bounded import Bounded
from tfbus.runtime.executor import Executor
from tfbus.wire.keys import stream_of
from tfbus.wire.numbered import NO_NUMBERS, FrameNumbers
from tfbus.wire.transforms import TransformMessage, decode_transforms, is_numbered

# So many messages wait for the names of their frames; the oldest go first.
_MOST_WAITING = 1000


class NamedMessages:
    """Calls `receive(key, message, size)` for each message that `take` gets, of so many bytes; on
    the thread that brings it or, if it had to wait for its stream's description, on another one.

    Streams are watched from the first message on whose frames have numbers, until `close()` or the
    node's end.
    """

    def __init__(
        self,
        node: Node,
        receive: Callable[[str, TransformMessage, int], object],
        *,
        everywhere: bool = False,
    ) -> None:
        self._node = node
        self._receive = receive
        self._everywhere = everywhere
        self._lock = scheduler.Lock()
        self._numbers: Bounded[str, FrameNumbers] = Bounded(_MOST_WAITING)
        self._waiting: deque[tuple[str, bytes]] = deque(maxlen=_MOST_WAITING)
        self._executor: Executor | None = None
        self._watch: StreamWatch | None = None
        self._is_closed = False

    def take(self, key: str, payload: bytes) -> None:
        """Receive a message. Raises DecodeError if it is none."""
        if not is_numbered(payload):
            self._receive(key, decode_transforms(payload), len(payload))
            return
        numbers = self._numbers.get(stream_of(key), NO_NUMBERS)
        message = decode_transforms(payload, numbers)
        if not message.unnamed:
            self._receive(key, message, len(payload))
            return
        with self._lock:
            self._waiting.append((key, payload))
            if self._executor is None:
                self._executor = Executor(f"{self._node.full_name} names", self._node.log)
                # Not on a thread of Zenoh, which may hold locks.
                self._executor.submit("names", self._start)

    def close(self) -> None:
        """Receive nothing from now on. Twice is fine."""
        self._is_closed = True
        if self._watch is not None:
            self._watch.close()
        elif self._executor is not None:
            self._executor.close()

    def _start(self) -> None:
        if not self._is_closed:
            self._watch = StreamWatch(
                self._node.session,
                self._on_stream,
                everywhere=self._everywhere,
                log=self._node.log,
                executor=self._executor,
            )

    def _on_stream(self, state: StreamState) -> None:
        description = state.description
        if description is None or not description.numbered:
            return
        self._numbers[state.name] = numbers = description.numbers
        with self._lock:
            waiting = [each for each in self._waiting if stream_of(each[0]) == state.name]
            left = [each for each in self._waiting if stream_of(each[0]) != state.name]
            self._waiting = deque(left, maxlen=_MOST_WAITING)
        for key, payload in waiting:
            message = decode_transforms(payload, numbers)
            if len(message.rows) and not self._is_closed:
                self._receive(key, message, len(payload))
