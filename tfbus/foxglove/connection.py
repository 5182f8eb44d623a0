"""A client's WebSocket: messages in, and messages out from any thread, which never wait."""

import asyncio
import itertools
import threading
from collections import deque
from collections.abc import AsyncIterator
from contextlib import suppress
from typing import Any

from websockets.exceptions import InvalidState
from websockets.frames import Frame, Opcode
from websockets.http11 import Request
from websockets.protocol import State
from websockets.server import ServerProtocol
from websockets.typing import Subprotocol

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
        disconnected. It overtakes what was sent before, unless it is to come `in_order`.
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
        """Write what is to be sent, until it is cancelled or the client is gone; no faster than
        the client takes it.
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
        """Write what the protocol says: messages, and answers to pings and to the end."""
        self._writer.write(b"".join(self._protocol.data_to_send()))


_DATA = (Opcode.TEXT, Opcode.BINARY, Opcode.CONT)
