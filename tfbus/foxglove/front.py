"""The port that clients connect to: which of them the server serves."""

import asyncio
import socket
import ssl
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING
from urllib.parse import parse_qs, quote

from tfbus.base import scheduler
from tfbus.base.addresses import NO_HOST_NAME, names_to_open, names_to_open_elsewhere
from tfbus.base.errors import TfbusError
from tfbus.command.server_access import AccessToken, PageGate, ServerTls, machine_names

if TYPE_CHECKING:
    from tfbus.foxglove.server import Server  # websockets, which `tfbus foxglove --help` may lack


@dataclass(frozen=True)
class Serving:
    """The address to listen at: the first free port from `port` on.

    Web pages of further `origins` may connect, such as `http://viewer.lan:8080`.
    With a `tls` connections are encrypted; with a `token` clients need it, as a query of the URL.
    """

    host: str = "127.0.0.1"
    port: int = 8765
    origins: tuple[str, ...] = ()
    tls: ServerTls | None = None
    token: AccessToken | None = None


# A client must have sent its request by then, which is at most this long.
_PATIENCE_S = 10.0
_LONGEST_REQUEST = 16_384

# Of clients at the same time.
MOST_CLIENTS = 64

# Connections that have not sent their request: where there are more, one is closed.
_MOST_WAITING = 64

# Where no connection can be taken, as there are too many open files, after this time it is tried
# again.
_RETRY_S = 0.2

# Where the port is taken, this many ones after it are tried.
_PORTS = 20

_FOXGLOVE = "foxglove.dev"


def _is_foxglove(scheme: str, host: str) -> bool:
    return scheme == "https" and f".{host}".endswith(f".{_FOXGLOVE}")


class Front:
    """Listens at an address, and lets a server serve the clients that may connect, until `close()`.

    If the port is taken it is the first free one after it. Raises TfbusError if it cannot
    listen. `on_refused(reason)` is called for each client that is refused.
    """

    def __init__(
        self,
        serving: Serving,
        server: "Server",
        on_refused: Callable[[str], object],
    ) -> None:
        self.clients = 0
        self._host, self._wanted_port = serving.host, serving.port
        self._gate = PageGate(
            machine_names(serving.host),
            serving.origins,
            _is_foxglove,
            advice=f"pages of {_FOXGLOVE} and of this machine may, and those of --allow-origin",
        )
        self._tls, self._token = serving.tls, serving.token
        self._server = server
        # Connections that have not sent their request, by their addresses, the first first.
        self._waiting: dict[asyncio.Task[None], str] = {}
        self._on_refused = on_refused
        self._sockets = listening_sockets(serving.host, serving.port)
        self.port: int = self._sockets[0].getsockname()[1]
        self._loop = scheduler.new_event_loop()
        self._ended = asyncio.Event()
        self._thread = scheduler.Thread(target=self._run, name="foxglove clients", daemon=True)
        self._thread.start()

    @property
    def addresses(self) -> tuple[str, ...]:
        """The addresses for clients: `ws://localhost:8765`; for clients of other machines this
        machine's name or address, with a token that was made for this run.
        """
        names = names_to_open if self._tls is None else names_to_open_elsewhere
        scheme = "ws" if self._tls is None else "wss"
        token = self._token
        query = f"/?token={quote(token.text)}" if token is not None and token.is_new else ""
        return tuple(
            f"{scheme}://{f'[{name}]' if ':' in name else name}:{self.port}{query}"
            for name in names(self._host)
        )

    def announcement(self) -> str:
        """The address to open, in a line."""
        if self._token is not None:
            # No link: it would carry the token to Foxglove's site.
            more = "" if self._token.is_new else "/?token=…"
            return f"Foxglove: connect to {' or '.join(each + more for each in self.addresses)}"
        url = page_url(self.addresses[0])
        return f"Foxglove: open {url} or connect to {' or '.join(self.addresses)}"

    def warnings(self) -> list[str]:
        """The notes on the address for its user."""
        if self._wanted_port in (0, self.port):
            return []
        return [f"port {self._wanted_port} of {self._host} is taken: using {self.port}"]

    def close(self) -> None:
        """Stop listening, and disconnect all clients. Twice is fine."""
        if self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._ended.set)
            self._thread.join(_PATIENCE_S)

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        try:
            self._loop.run_until_complete(self._serve())
        finally:
            self._loop.close()

    async def _serve(self) -> None:
        tasks = [asyncio.create_task(self._accept(each)) for each in self._sockets]
        await self._ended.wait()
        tasks = [*asyncio.all_tasks() - {asyncio.current_task()}]
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        for each in self._sockets:
            each.close()

    async def _accept(self, listening: socket.socket) -> None:
        """Take connections, each as a task of its own."""
        while True:
            try:
                taken, address = await self._loop.sock_accept(listening)
            except OSError:
                await asyncio.sleep(_RETRY_S)
                continue
            task = self._loop.create_task(self._meet(taken, str(address[0])))
            self._waiting[task] = str(address[0])
            task.add_done_callback(self._has_asked)
            if len(self._waiting) > _MOST_WAITING:
                self._longest_waiting().cancel()

    def _has_asked(self, task: "asyncio.Task[None] | None") -> None:
        """A connection has sent its request, or ended."""
        if task is not None:
            self._waiting.pop(task, None)

    def _longest_waiting(self) -> asyncio.Task[None]:
        """The first connection of the address with the most that have sent no request."""
        [(most, _)] = Counter(self._waiting.values()).most_common(1)
        return next(task for task, address in self._waiting.items() if address == most)

    async def _meet(self, taken: socket.socket, address: str) -> None:
        """Answer a connection, or let the server serve it."""
        with suppress(OSError, EOFError, asyncio.LimitOverrunError), taken:
            deadline = self._loop.time() + _PATIENCE_S
            async with asyncio.timeout_at(deadline):
                reader, writer = await _opened(
                    taken, None if self._tls is None else self._tls.context
                )
            try:
                head = b""
                with suppress(TimeoutError):
                    async with asyncio.timeout_at(deadline):
                        head = await reader.readuntil(b"\r\n\r\n")
                self._has_asked(asyncio.current_task())
                if answer := self._answer(head, address):
                    writer.write(answer)
                    await writer.drain()
                else:
                    await self._let_in(head, reader, writer)
                writer.close()
                async with asyncio.timeout(_PATIENCE_S):
                    await writer.wait_closed()
            finally:
                # Before the socket is closed: else the loop waits for its number, which the next
                # connection gets.
                writer.transport.abort()

    async def _let_in(
        self, head: bytes, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
        self.clients += 1
        try:
            await self._server.serve(head, reader, writer)
        finally:
            self.clients -= 1

    def _answer(self, head: bytes, address: str) -> bytes:
        """The answer to a client that is not passed on; b"" for one that is."""
        if not head:
            return _response("408 Request Timeout", f"no request within {_PATIENCE_S:g} s")
        headers = _headers(head)
        if refused := self._refused(head, address):
            return refused
        if headers.get("upgrade", "").lower() != "websocket":
            text = f"Here is tfbus for {self.announcement()}"
            return _response("426 Upgrade Required", text, "Upgrade: websocket\r\n")
        if reason := self._gate.refusal(headers.get("origin"), headers.get("host", "")):
            self._on_refused(reason)
            return _response("403 Forbidden", reason)
        if self.clients >= MOST_CLIENTS:
            return _response("503 Service Unavailable", f"{MOST_CLIENTS} clients are connected")
        return b""

    def _refused(self, head: bytes, address: str) -> bytes:
        """The answer to a client without the token; b"" if it has, or there is none."""
        if self._token is None:
            return b""
        target = head.split(b"\r\n", 1)[0].decode("latin-1").split(" ")[1:2]
        given = parse_qs("".join(target).partition("?")[2]).get("token", [""])[0]
        if not given:
            text = "this address needs the token that tfbus foxglove has printed: /?token=…"
            return _response("401 Unauthorized", text)
        match self._token.judge(given, address):
            case "right":
                return b""
            case "wrong":
                self._on_refused(f"a wrong token from {address}")
                return _response("401 Unauthorized", "that is not the token")
            case "too often":
                return _response("429 Too Many Requests", "too many wrong tokens: wait a minute")


def page_url(address: str, *, desktop: bool = False) -> str:
    """The link that opens Foxglove, in a browser or its application, connected to an address."""
    base = "foxglove://open" if desktop else "https://app.foxglove.dev/"
    return f"{base}?ds=foxglove-websocket&ds.url={quote(address, safe='')}"


async def _opened(
    taken: socket.socket, context: ssl.SSLContext | None
) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
    """Streams of a connection that was taken; over TLS once its handshake is done."""
    loop = asyncio.get_running_loop()
    reader = asyncio.StreamReader(limit=_LONGEST_REQUEST)
    protocol = asyncio.StreamReaderProtocol(reader)
    transport, _ = await loop.connect_accepted_socket(lambda: protocol, taken, ssl=context)
    return reader, asyncio.StreamWriter(transport, protocol, reader, loop)


def _headers(head: bytes) -> dict[str, str]:
    """The headers of a request by their names in small letters."""
    lines = head.decode("latin-1").split("\r\n")[1:]
    pairs = (line.partition(":") for line in lines)
    return {name.strip().lower(): value.strip() for name, _, value in pairs}


def _response(status: str, text: str, headers: str = "") -> bytes:
    body = f"{text}\n".encode()
    head = (
        f"HTTP/1.1 {status}\r\n{headers}Content-Type: text/plain; charset=utf-8\r\n"
        f"Content-Length: {len(body)}\r\nConnection: close\r\n\r\n"
    )
    return head.encode() + body


def listening_sockets(host: str, port: int) -> list[socket.socket]:
    """Sockets that listen at a host, on the first free port of these."""
    error: OSError | None = None
    for each in range(port, min(port + _PORTS, 65536)) if port else (0,):
        try:
            return _bound(host, each)
        except OSError as reason:
            error = error or reason
            if isinstance(reason, socket.gaierror):
                break
        except UnicodeError as reason:
            raise TfbusError(f"could not listen at {host}:{port}: {NO_HOST_NAME}") from reason
    assert error is not None
    raise TfbusError(f"could not listen at {host}:{port}: {error.strerror or error}") from error


def _bound(host: str, port: int) -> list[socket.socket]:
    found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
    family, kind, protocol, _, address = found[0]
    bound = socket.socket(family, kind, protocol)
    try:
        bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        bound.bind(address)
        bound.listen()
        bound.setblocking(False)
    except BaseException:
        bound.close()
        raise
    return [bound]
