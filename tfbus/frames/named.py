"""Messages of transforms as they come, with the names of frames that have numbers in them."""

from collections.abc import Callable
from functools import partial

from tfbus.base import scheduler
from tfbus.base.bounded import Bounded
from tfbus.base.errors import DecodeError
from tfbus.base.executor import Executor
from tfbus.base.log import LogOnce
from tfbus.node.node import Node
from tfbus.streams.info import StreamState
from tfbus.streams.reception import NOT_NAMED, TIMES_HELD, TOO_MANY_WAIT
from tfbus.streams.stream_facts import OF_EPOCH, OF_NAMES, PendingMessages
from tfbus.streams.watch import StreamWatch
from tfbus.wire.descriptions import FLOAT64, StreamDescription
from tfbus.wire.keys import stream_of
from tfbus.wire.numbered import NO_NUMBERS, FrameNumbers, numbers_of
from tfbus.wire.transforms import TransformMessage, decode_transforms

# Names come from the bus: the numbers of at most so many streams are known.
_MOST_STREAMS = 1000

# The numbers of a stream, and the description that they are from.
_Numbers = tuple[FrameNumbers, StreamDescription | None]
_NONE: _Numbers = NO_NUMBERS, None


class NamedMessages:
    """Calls `receive(key, message, size)` for each message that `decode` gets, of so many bytes; on
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
        self._once = LogOnce(node.log)
        self._numbers: Bounded[str, _Numbers] = Bounded(_MOST_STREAMS)
        self._pending = PendingMessages()
        self._executor: Executor | None = None
        self._watch: StreamWatch | None = None
        self._is_closed = False

    def decode(self, key: str, payload: bytes) -> None:
        """Decode a message, and pass it on. Raises DecodeError if it is none."""
        self._decode_or_hold(key, payload, TIMES_HELD)

    def _decode_or_hold(self, key: str, payload: bytes, times: int) -> None:
        """Receive a message, which may be held for so many more descriptions."""
        name = stream_of(key)
        numbers, _ = self._numbers.get(name, _NONE)
        message = decode_transforms(payload, numbers)
        if not message.unnamed or not times:
            if message.unnamed:
                self._once.warning(name, NOT_NAMED, name)
            if not self._is_closed and (len(message.rows) or not message.unnamed):
                self._receive(key, message, len(payload))
            return
        receive = partial(self._decode_again, key, times=times - 1)
        of = OF_NAMES if message.epoch_ns == numbers.epoch_ns else OF_EPOCH
        if dropped := self._pending.add(name, message.epoch_ns, receive, payload, of):
            self._once.warning("full", TOO_MANY_WAIT, dropped)
        with self._lock:
            if self._executor is None and not self._is_closed:
                self._executor = Executor(f"{self._node.full_name} names", self._node.log)
                # Not on a thread of Zenoh, which may hold locks.
                self._executor.submit("names", self._start)
        now, _ = self._numbers.get(name, _NONE)
        if now is not numbers and now.epoch_ns == message.epoch_ns:  # it came in between
            self._pending.release(name, message.epoch_ns)

    def _decode_again(self, key: str, payload: bytes, times: int) -> None:
        try:
            self._decode_or_hold(key, payload, times)
        except DecodeError as error:
            self._once.warning((key, DecodeError), "Dropped a message on %s: %s", key, error)

    def close(self) -> None:
        """Receive nothing from now on. Twice is fine."""
        with self._lock:
            self._is_closed = True
        if self._watch is not None:
            self._watch.close()
        elif self._executor is not None:
            self._executor.close()

    def _start(self) -> None:
        if self._is_closed:
            return
        watch = StreamWatch(
            self._node.session,
            self._on_stream,
            everywhere=self._everywhere,
            log=self._node.log,
            executor=self._executor,
        )
        with self._lock:
            self._watch, was_closed = watch, self._is_closed
        if was_closed:  # meanwhile
            watch.close()

    def _on_stream(self, state: StreamState) -> None:
        description = state.description
        _, former = self._numbers.get(state.name, _NONE)
        # Also called where only the token has changed, for which no message waits.
        if description is None or description is former:
            return
        if description.poses != FLOAT64:
            self._numbers[state.name] = numbers_of(description), description
            # It may be of a former epoch, whose publisher is about to go.
            self._pending.release(state.name, description.epoch, is_last=False)
