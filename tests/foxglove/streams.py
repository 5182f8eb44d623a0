"""Streams between event loops of a simulated network, which a port and its clients have instead of
sockets. All that is above them is asyncio's, websockets' and the server's own.
"""

import asyncio
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from typing import Any

_HOST = "127.0.0.1"


class Streams:
    """The ports of one host, and what event loops do with sockets."""

    def __init__(self) -> None:
        self._ports: dict[int, Listening] = {}

    def listen(self, host: str, port: int) -> "list[Listening]":
        """As `front.listening_sockets`, on a port that is always free."""
        made = Listening(port or 50_000 + len(self._ports))
        self._ports[made.port] = made
        return [made]

    async def sock_accept(
        self, loop: asyncio.AbstractEventLoop, listening: "Listening"
    ) -> "tuple[Taken, tuple[str, int]]":
        """The next client."""
        return await listening.accept(loop), (_HOST, 1)

    async def connect_accepted_socket(
        self,
        loop: asyncio.AbstractEventLoop,
        factory: Callable[[], Any],
        taken: "Taken",
        *,
        ssl: object = None,
    ) -> "tuple[End, Any]":
        """The end of the server."""
        assert ssl is None, "there is no TLS without sockets"
        end = End(loop, factory())
        taken.end = end
        taken.client.meet(end)
        end.meet(taken.client)
        return end, end.get_protocol()

    async def create_connection(
        self,
        loop: asyncio.AbstractEventLoop,
        factory: Callable[[], Any],
        host: str = _HOST,
        port: int = 0,
        **_: object,
    ) -> "tuple[End, Any]":
        """The end of a client."""
        listening = self._ports.get(port)
        if listening is None or listening.is_closed:
            raise ConnectionRefusedError(f"nobody listens on port {port}")
        end = End(loop, factory())
        listening.arrive(Taken(end))
        return end, end.get_protocol()


class Listening:
    """Stands in for a socket that listens."""

    def __init__(self, port: int) -> None:
        self.port = port
        self.is_closed = False
        self._arrived: deque[Taken] = deque()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._is_there = asyncio.Event()

    def getsockname(self) -> tuple[str, int]:
        return _HOST, self.port

    def close(self) -> None:
        self.is_closed = True

    def arrive(self, taken: "Taken") -> None:
        """On the loop of a client."""
        self._arrived.append(taken)
        if self._loop is not None:
            self._loop.call_soon_threadsafe(self._is_there.set)

    async def accept(self, loop: asyncio.AbstractEventLoop) -> "Taken":
        """On the loop of the server."""
        self._loop = loop
        while not self._arrived:
            self._is_there.clear()
            await self._is_there.wait()
        return self._arrived.popleft()


class Taken:
    """Stands in for the socket of a connection that was taken."""

    def __init__(self, client: "End") -> None:
        self.client = client
        self.end: End | None = None

    def __enter__(self) -> "Taken":
        return self

    def __exit__(self, *_: object) -> None:
        if self.end is None:
            self.client.hear(self.client.take_end)


class End(asyncio.Transport):
    """One end of a stream. It writes at once: whoever does not read has it all in his loop."""

    def __init__(self, loop: asyncio.AbstractEventLoop, protocol: Any) -> None:
        super().__init__({"peername": (_HOST, 1), "sockname": (_HOST, 2)})
        self._loop = loop
        self._protocol = protocol
        self._peer: End | None = None
        self._early: deque[bytes] = deque()
        self._is_closing = False
        protocol.connection_made(self)

    def meet(self, peer: "End") -> None:
        """All that is written goes to this end, also if it was written before."""
        while self._early:
            peer.hear(peer.take, self._early.popleft())
        self._peer = peer
        if self._is_closing:
            peer.hear(peer.take_end)

    def hear(self, what: Callable[..., object], *args: object) -> None:
        """Do something in the loop of this end, unless that has ended."""
        with suppress(RuntimeError):
            self._loop.call_soon_threadsafe(what, *args)

    def take(self, data: bytes) -> None:
        """Bytes of the other end."""
        if not self._is_closing:
            self._protocol.data_received(data)

    def take_end(self) -> None:
        """The other end writes no more."""
        if not self._is_closing and not self._protocol.eof_received():
            self.close()

    # As asyncio's

    def write(self, data: bytes | bytearray | memoryview) -> None:
        if not self._is_closing and data:
            if self._peer is None:
                self._early.append(bytes(data))
            else:
                self._peer.hear(self._peer.take, bytes(data))

    def can_write_eof(self) -> bool:
        return True

    def write_eof(self) -> None:
        if self._peer is not None:
            self._peer.hear(self._peer.take_end)

    def close(self) -> None:
        if not self._is_closing:
            self._is_closing = True
            self.write_eof()
            self._loop.call_soon(self._protocol.connection_lost, None)

    abort = close

    def is_closing(self) -> bool:
        return self._is_closing

    def is_reading(self) -> bool:
        return not self._is_closing

    def pause_reading(self) -> None:
        pass

    def resume_reading(self) -> None:
        pass

    def set_write_buffer_limits(self, high: int | None = None, low: int | None = None) -> None:
        pass

    def get_write_buffer_size(self) -> int:
        return 0

    def get_protocol(self) -> Any:
        return self._protocol

    def set_protocol(self, protocol: Any) -> None:
        self._protocol = protocol
