"""A client of Foxglove's server: its WebSocket, the messages that it sends, its subscriptions."""

import asyncio
import itertools
import json
import struct
import threading
from collections import deque
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING, Any

from websockets.exceptions import InvalidState
from websockets.frames import Frame, Opcode
from websockets.http11 import Request
from websockets.protocol import State
from websockets.server import ServerProtocol
from websockets.typing import Subprotocol

from tfbus.base.errors import TfbusError
from tfbus.base.wording import printable
from tfbus.foxglove.protocol import (
    CALLED,
    CONTROLLED,
    PUBLISHED,
    Capability,
    ClientChannel,
    Level,
    PlaybackControl,
    PlaybackState,
    ShownParameter,
    called,
    number,
    numbers,
    parameter_values,
    published,
    request_id,
    text,
    texts,
)

if TYPE_CHECKING:
    from tfbus.foxglove.server import ServedChannel, Server

# A client that reads too slowly loses the oldest messages of topics beyond this number, and is
# disconnected where as many others wait.
BACKLOG = 1024

# Bytes of the same: of the messages of topics, of which the newest is kept in any case, and of the
# others, as files are.
_MOST_SENT = 1 << 28
_MOST_TOLD = 1 << 30

# Of a client; longer ones end its connection.
_LONGEST_MESSAGE = 1 << 20

_CHUNK = 65_536

# Messages, and bytes beyond which none is added, that are written at a time: Zenoh's threads append
# meanwhile, and the newest of it counts.
_AT_A_TIME = 64
_MUCH = 1 << 20

# A client that leaves so many bytes unread is not read from: else it could ask for answers without
# end.
_MOST_UNREAD = 1 << 24


class Connection:
    """The WebSocket of one client. `tell` and `send` may be called on any thread; the rest belongs
    to the loop.
    """

    def __init__(
        self, head: bytes, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, name: str
    ) -> None:
        """Answer the request with the head `head`, for the subprotocol `name`."""
        self._reader, self._writer = reader, writer
        self._loop = asyncio.get_running_loop()
        self._order = itertools.count(1)
        # With the place in the order that it has to keep, 0 where it may overtake.
        self._told: deque[tuple[int, str | bytes]] = deque()
        self._sent: deque[tuple[int, bytes]] = deque()
        self._told_bytes = self._sent_bytes = 0
        self._lock = threading.Lock()  # of both, and their bytes
        self._wake = asyncio.Event()
        self._is_woken = False
        self._protocol = ServerProtocol(subprotocols=[Subprotocol(name)], max_size=_LONGEST_MESSAGE)
        self._protocol.receive_data(head)
        for request in self._protocol.events_received():
            assert isinstance(request, Request)
            self._protocol.send_response(self._protocol.accept(request))
        self._flush()

    @property
    def is_open(self) -> bool:
        """Whether the client's request was one for a WebSocket, and it has not ended."""
        return self._protocol.state is State.OPEN

    # On any thread

    def tell(self, message: str | bytes, *, in_order: bool = False) -> None:
        """Send a message that is never left out: a client that reads none of them is
        disconnected. It overtakes earlier messages, unless it is to come `in_order`.
        """
        with self._lock:
            is_full = len(self._told) >= BACKLOG or self._told_bytes >= _MOST_TOLD
            if not is_full:
                self._told.append((next(self._order) if in_order else 0, message))
                self._told_bytes += len(message)
        if is_full:
            self._call(self._writer.transport.abort)
        else:
            self._wake_up()

    def send(self, message: bytes) -> None:
        """Send a message; it is left out if the client falls behind."""
        with self._lock:
            self._sent.append((next(self._order), message))
            self._sent_bytes += len(message)
            while len(self._sent) > BACKLOG or (
                self._sent_bytes > _MOST_SENT and len(self._sent) > 1
            ):
                self._take_sent()
        self._wake_up()

    def _wake_up(self) -> None:
        if not self._is_woken:
            self._is_woken = True
            self._call(self._wake.set)

    def _call(self, what: Any) -> None:
        with suppress(RuntimeError):  # the loop has ended
            self._loop.call_soon_threadsafe(what)

    # In the loop

    async def write(self) -> None:
        """Write the waiting messages, until it is cancelled or the client is gone; no faster than
        the client takes them.
        """
        with suppress(OSError):
            while True:
                await self._wake.wait()
                self._wake.clear()
                self._is_woken = False
                while self._write_some():
                    await self._writer.drain()

    def _write_some(self) -> bool:
        """Write some messages; whether there were any."""
        some = size = 0
        with suppress(InvalidState):
            while some < _AT_A_TIME and size < _MUCH and (message := self._next()) is not None:
                if isinstance(message, str):
                    self._protocol.send_text(message.encode())
                else:
                    self._protocol.send_binary(message)
                some += 1
                size += len(message)
        self._flush()
        return some > 0

    def _next(self) -> str | bytes | None:
        """Take the next message: one that must not be left out, if none of before has to come
        first; None if there is none.
        """
        with self._lock:
            if self._told and not (self._sent and self._sent[0][0] < self._told[0][0]):
                message = self._told.popleft()[1]
                self._told_bytes -= len(message)
                return message
            return self._take_sent() if self._sent else None

    def _take_sent(self) -> bytes:
        message = self._sent.popleft()[1]
        self._sent_bytes -= len(message)
        return message

    async def messages(self) -> AsyncIterator[str | bytes]:
        """Iterate over the messages of the client, until it ends."""
        parts: list[bytes] = []
        is_text = False
        while self.is_open and (data := await self._reader.read(_CHUNK)):
            self._protocol.receive_data(data)
            for frame in self._protocol.events_received():
                if not isinstance(frame, Frame) or frame.opcode not in _DATA:
                    continue
                if frame.opcode is not Opcode.CONT:
                    parts, is_text = [], frame.opcode is Opcode.TEXT
                parts.append(bytes(frame.data))
                if frame.fin:
                    message = b"".join(parts)
                    yield message.decode(errors="replace") if is_text else message
            self._flush()
            if self._writer.transport.get_write_buffer_size() > _MOST_UNREAD:
                await self._writer.drain()

    def _flush(self) -> None:
        """Write the protocol's bytes: messages, and answers to pings and to the end."""
        self._writer.write(b"".join(self._protocol.data_to_send()))


_DATA = (Opcode.TEXT, Opcode.BINARY, Opcode.CONT)


# Of one client, and so of its memory here.
_MOST_NAMES = 10_000
_MOST_CHANNELS = 1_000

# Operations that not every server offers.
_NEEDS = {
    "advertise": Capability.PUBLISH,
    "unadvertise": Capability.PUBLISH,
    "getParameters": Capability.PARAMETERS,
    "setParameters": Capability.PARAMETERS,
    "subscribeParameterUpdates": Capability.PARAMETERS,
    "unsubscribeParameterUpdates": Capability.PARAMETERS,
    "subscribeConnectionGraph": Capability.GRAPH,
    "unsubscribeConnectionGraph": Capability.GRAPH,
    PUBLISHED: Capability.PUBLISH,
    CALLED: Capability.SERVICES,
    CONTROLLED: Capability.PLAYBACK,
}


class Requests:
    """The requests and messages of clients; a bridge overrides the answers.

    All but `set_parameters` and `asset` come on the thread that serves all clients: return at once.
    """

    def subscribed(self, channel_id: int) -> None:
        """A client subscribes to a channel."""

    def unsubscribed(self, channel_id: int) -> None:
        """A client no longer subscribes, or is gone."""

    def get_parameters(self, names: Sequence[str]) -> list[ShownParameter]:
        """These parameters; all if no name is given."""
        return []

    def set_parameters(self, given: Sequence[ShownParameter]) -> list[ShownParameter]:
        """Set parameters; returns the ones that are known to be set by now. It may wait."""
        return []

    def parameters_subscribed(self, names: Sequence[str]) -> None:
        """A client subscribes to parameters."""

    def advertised(self, client_id: int, channel: ClientChannel) -> None:
        """A client is going to publish."""

    def unadvertised(self, client_id: int, channel_id: int) -> None:
        """A client no longer publishes, or is gone."""

    def published(self, client_id: int, channel_id: int, data: bytes) -> None:
        """A client publishes."""

    def control(self, request: PlaybackControl) -> PlaybackState | None:
        """A client plays, pauses, seeks, or changes the speed; None if the answer follows."""
        return None

    def asset(self, uri: str) -> bytes:
        """A client asks for a file. Raises TfbusError if it cannot have it. It may wait."""
        raise TfbusError("there are no files")


class ServedClient:
    """A client from its first message on; all calls but `tell` and `say` come in its loop."""

    def __init__(self, own_id: int, connection: Connection, server: "Server") -> None:
        self.connection = connection
        self.tell = connection.tell
        # The server's, under its lock.
        self.subscriptions: dict[int, ServedChannel] = {}
        self.parameters: frozenset[str] = frozenset()
        self.has_graph = False
        self._id = own_id
        self._server = server
        self._requests = server.requests
        self._advertised: dict[int, ClientChannel] = {}

    def say(self, reason: str, level: Level = Level.ERROR) -> None:
        """Show an error in this client."""
        self.tell(text("status", level=level, message=printable(reason, 500)))

    def take(self, message: str | bytes) -> None:
        """Follow a client's message; a malformed one is answered with the reason."""
        try:
            if isinstance(message, str):
                given = json.loads(message)
                op, wish = given["op"], partial(self._wish, given)
            else:
                op, wish = message[0], partial(self._binary_wish, message)
            needed = _NEEDS.get(op)
            if needed is not None and needed not in self._server.capabilities:
                self.say(f"this server has not the capability {needed}")
                return
            wanted = wish()
        except (LookupError, RecursionError, TypeError, ValueError, struct.error) as error:
            self.say(f"invalid message: {error}")
        else:
            self._server.guarded(wanted)

    def leave(self) -> None:
        """End all that it had: it is gone."""
        self._server.guarded(lambda: self._unsubscribe(list(self.subscriptions)))
        self._server.guarded(lambda: self._unadvertise(list(self._advertised)))

    def _wish(self, given: Mapping[str, Any]) -> Callable[[], None]:
        """The call that a text asks for. Raises if it is malformed."""
        match given["op"]:
            case "subscribe":
                wanted = [(number(x["id"]), number(x["channelId"])) for x in given["subscriptions"]]
                return partial(self._subscribe, wanted)
            case "unsubscribe":
                return partial(self._unsubscribe, numbers(given["subscriptionIds"]))
            case "advertise":
                channels = [ClientChannel.from_map(each) for each in given["channels"]]
                return partial(self._advertise, channels)
            case "unadvertise":
                return partial(self._unadvertise, numbers(given["channelIds"]))
            case "getParameters":
                return partial(self._get, texts(given["parameterNames"]), request_id(given))
            case "setParameters":
                parameters = [ShownParameter.from_map(each) for each in given["parameters"]]
                return partial(self._server.set_parameters, self, parameters, request_id(given))
            case "subscribeParameterUpdates":
                return partial(self._watch, texts(given["parameterNames"]))
            case "unsubscribeParameterUpdates":
                return partial(self._ignore, texts(given["parameterNames"]))
            case "subscribeConnectionGraph":
                return partial(self._server.subscribe_graph, self)
            case "unsubscribeConnectionGraph":
                return partial(setattr, self, "has_graph", False)
            case "fetchAsset":
                request, [uri] = number(given["requestId"]), texts([given["uri"]])
                return partial(self._server.fetch, self, request, uri)
            case op:
                raise ValueError(f"there is no operation {printable(op)!r}")

    def _binary_wish(self, data: bytes) -> Callable[[], None]:
        """The call that a binary message asks for. Raises if it is malformed."""
        match data[0]:
            case kind if kind == PUBLISHED:
                return partial(self._publish, *published(data))
            case kind if kind == CALLED:
                service, call, encoding, request = called(data)
                if encoding != "json":
                    raise ValueError(f"requests are json, not {printable(encoding)}")
                return partial(self._server.call, self, service, call, request)
            case kind if kind == CONTROLLED:
                return partial(self._control, PlaybackControl.from_bytes(data))
            case kind:
                raise ValueError(f"there is no kind {kind} of binary messages")

    # Its wishes

    def _subscribe(self, wanted: Sequence[tuple[int, int]]) -> None:
        for subscription, channel_id in wanted:
            if mistake := self._server.subscribe(self, subscription, channel_id):
                self.say(mistake)
            else:
                self._requests.subscribed(channel_id)

    def _unsubscribe(self, subscriptions: Sequence[int]) -> None:
        for channel_id in self._server.unsubscribe(self, subscriptions):
            self._requests.unsubscribed(channel_id)

    def _advertise(self, channels: Sequence[ClientChannel]) -> None:
        for channel in channels:
            if channel.id in self._advertised:
                self.say(f"channel {channel.id} is advertised already", Level.WARNING)
            elif len(self._advertised) >= _MOST_CHANNELS:
                self.say(f"at most {_MOST_CHANNELS} channels of a client")
            else:
                self._advertised[channel.id] = channel
                self._requests.advertised(self._id, channel)

    def _unadvertise(self, channel_ids: Sequence[int]) -> None:
        for channel_id in channel_ids:
            if self._advertised.pop(channel_id, None) is not None:
                self._requests.unadvertised(self._id, channel_id)

    def _publish(self, channel_id: int, data: bytes) -> None:
        if channel_id in self._advertised:
            self._requests.published(self._id, channel_id, data)
        else:
            self.say(f"channel {channel_id} is not advertised")

    def _get(self, names: Sequence[str], request: str | None) -> None:
        self.tell(parameter_values(self._requests.get_parameters(names), request))

    def _watch(self, names: Sequence[str]) -> None:
        if len(self.parameters | set(names)) > _MOST_NAMES:
            self.say(f"at most {_MOST_NAMES} parameters of a client")
            return
        self.parameters |= set(names)
        self._requests.parameters_subscribed(names)

    def _ignore(self, names: Sequence[str]) -> None:
        self.parameters -= set(names)

    def _control(self, request: PlaybackControl) -> None:
        state = self._requests.control(request)
        if state is not None:
            self._server.tell_playback(state)
