"""The port that clients connect to, in front of the SDK's, which serves any web page.

A browser lets each page that its user opens connect to this machine, and the header Origin alone
says which page it is. So a page of another host is refused; programs, Foxglove's application and
its page are not.
"""

import asyncio
import platform
import secrets
import socket
import threading
from collections.abc import Callable, Collection
from contextlib import suppress
from urllib.parse import SplitResult, parse_qs, quote, urlsplit

from tfbus.errors import TfbusError
from tfbus.foxglove.serving import Serving
from tfbus.runtime.addresses import is_local, names_to_open, names_to_open_elsewhere
from tfbus.wording import printable

# A client must have sent its request by then, which is at most this long.
_PATIENCE_S = 10.0
_LONGEST_REQUEST = 16_384

# Of clients at the same time.
MOST_CLIENTS = 64

# Where the port is taken, this many ones after it are tried.
_PORTS = 20

_CHUNK = 65_536

_FOXGLOVE = "foxglove.dev"


def hidden_host() -> str:
    """An address of this machine alone that a web page cannot guess; that is on Linux, elsewhere
    127.0.0.1.
    """
    if platform.system() != "Linux":
        return "127.0.0.1"
    return f"127.{secrets.randbelow(254) + 1}.{secrets.randbelow(256)}.{secrets.randbelow(254) + 1}"


def refusal(origin: str | None, allowed: Collection[str]) -> str:
    """Why a page of this origin is refused, in a sentence; "" where it is not, or no page."""
    if origin is None or origin in allowed:
        return ""
    parts = _parts(origin.lower())
    host = parts.hostname or ""
    if parts.scheme not in ("http", "https", ""):
        return ""  # as file: and those of applications, which no web page has
    is_foxglove = parts.scheme == "https" and f".{host}".endswith(f".{_FOXGLOVE}")
    if is_foxglove or (host and is_local(host)):
        return ""
    return (
        f"a page of {printable(origin, 100)} may not connect: only those of {_FOXGLOVE} and of "
        f"this machine may, or of an --allow-origin {printable(origin, 100)}"
    )


class Front:
    """Listens at an address, and passes what clients may send on to `inner`, until `close()`.

    Where the port is taken it is the first free one after it. Raises TfbusError where it cannot
    listen. `on_refused(reason)` is called for each client that is refused.
    """

    def __init__(
        self,
        serving: Serving,
        inner: tuple[str, int],
        on_refused: Callable[[str], object],
    ) -> None:
        self.clients = 0
        self._host, self._wanted_port = serving.host, serving.port
        self._allowed = serving.origins
        self._tls, self._token = serving.tls, serving.token
        self._inner = inner
        self._on_refused = on_refused
        self._sockets = _listening(serving.host, serving.port)
        self.port: int = self._sockets[0].getsockname()[1]
        self._loop = asyncio.new_event_loop()
        self._ended = asyncio.Event()
        self._thread = threading.Thread(target=self._run, name="foxglove clients", daemon=True)
        self._thread.start()

    @property
    def addresses(self) -> tuple[str, ...]:
        """Where clients connect: `ws://localhost:8765`; those of other machines by this machine's
        name or address, with a token that was made for this run.
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
        """Where to open it, in a line."""
        if self._token is not None:
            # No link: it would carry the token to Foxglove's site.
            more = "" if self._token.is_new else "/?token=…"
            return f"Foxglove: connect to {' or '.join(each + more for each in self.addresses)}"
        url = page_url(self.addresses[0])
        return f"Foxglove: open {url} or connect to {' or '.join(self.addresses)}"

    def warnings(self) -> list[str]:
        """What who started it should know of the address."""
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
        servers = [
            await asyncio.start_server(
                self._meet,
                sock=each,
                limit=_LONGEST_REQUEST,
                ssl=None if self._tls is None else self._tls.context,
            )
            for each in self._sockets
        ]
        await self._ended.wait()
        for server in servers:
            server.close()
        others = asyncio.all_tasks() - {asyncio.current_task()}
        for task in others:
            task.cancel()
        await asyncio.gather(*others, return_exceptions=True)

    async def _meet(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.clients += 1
        try:
            # Cancelled by `close`: asyncio would log that as an error.
            with suppress(OSError, EOFError, asyncio.LimitOverrunError, asyncio.CancelledError):
                async with asyncio.timeout(_PATIENCE_S):
                    head = await reader.readuntil(b"\r\n\r\n")
                if answer := self._answer(head, _address_of(writer)):
                    writer.write(answer)
                    await writer.drain()
                else:
                    await self._pass_on(head, reader, writer)
        finally:
            self.clients -= 1
            writer.close()

    def _answer(self, head: bytes, address: str) -> bytes:
        """What a client gets that is not passed on; b"" for one that is."""
        headers = _headers(head)
        if self.clients > MOST_CLIENTS:
            return _response("503 Service Unavailable", f"more than {MOST_CLIENTS} clients")
        if refused := self._refused(head, address):
            return refused
        if headers.get("upgrade", "").lower() != "websocket":
            text = f"Here is tfbus for {self.announcement()}"
            return _response("426 Upgrade Required", text, "Upgrade: websocket\r\n")
        if reason := refusal(headers.get("origin"), self._allowed):
            self._on_refused(reason)
            return _response("403 Forbidden", reason)
        return b""

    def _refused(self, head: bytes, address: str) -> bytes:
        """What a client gets that has not the token; b"" where it has, or there is none."""
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

    async def _pass_on(
        self, head: bytes, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
        inner_reader, inner_writer = await asyncio.open_connection(*self._inner, limit=_CHUNK)
        try:
            inner_writer.write(head)
            ways = [
                asyncio.create_task(_copy(reader, inner_writer)),
                asyncio.create_task(_copy(inner_reader, writer)),
            ]
            try:
                await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
            finally:
                for way in ways:
                    way.cancel()
                await asyncio.gather(*ways, return_exceptions=True)
        finally:
            inner_writer.close()


def page_url(address: str, *, desktop: bool = False) -> str:
    """The link that opens Foxglove, in a browser or its application, connected to an address."""
    base = "foxglove://open" if desktop else "https://app.foxglove.dev/"
    return f"{base}?ds=foxglove-websocket&ds.url={quote(address, safe='')}"


def _address_of(writer: asyncio.StreamWriter) -> str:
    peer = writer.get_extra_info("peername")
    return str(peer[0]) if peer else ""


async def _copy(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    """All that comes, until the end; no faster than the other side takes it."""
    with suppress(OSError):
        while data := await reader.read(_CHUNK):
            writer.write(data)
            await writer.drain()


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


def _listening(host: str, port: int) -> list[socket.socket]:
    """Sockets that listen at a host, on the first free port of these."""
    error: OSError | None = None
    for each in range(port, min(port + _PORTS, 65536)) if port else (0,):
        try:
            return _bound(host, each)
        except OSError as reason:
            error = error or reason
            if isinstance(reason, socket.gaierror):
                break
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
    except BaseException:
        bound.close()
        raise
    return [bound]


def _parts(url: str) -> SplitResult:
    """The parts of a URL; all empty where it is malformed."""
    try:
        return urlsplit(url)
    except ValueError:
        return urlsplit("")
