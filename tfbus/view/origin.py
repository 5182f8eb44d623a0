"""The guard of the page: which requests viser's server gets, and where the page may be framed."""

import gzip
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache, partial
from http import HTTPStatus
from typing import Any

from websockets.asyncio import server
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from tfbus.runtime.addresses import own_names
from tfbus.secure.gate import Gate, machine_names
from tfbus.view.access import Access

# viser connects while its document has the focus. One in a frame has not, until it is clicked.
_SCRIPT = b"<script>if(parent!==window)document.hasFocus=()=>true</script>"
_HEAD = b"<head>"


@dataclass
class Guard:
    """Which requests to a server at `host` are served: of its own pages and of programs, and with
    an `access` of those that have its token.

    If `is_framed`, pages of other machines may have the page in a frame. Calls `on_refused(reason)`
    for each request that is refused, except one without a token. It `stands` once a server asks it.
    """

    host: str
    access: Access | None = None
    is_framed: bool = False
    on_refused: Callable[[str], object] = lambda reason: None
    stands: bool = False

    def __post_init__(self) -> None:
        names = machine_names(self.host)
        if self.access is not None:
            names |= own_names() | self.access.tls.names
        self._gate = Gate(names, knows_neighbours=not names, advice="open the view directly")

    def check(self, then: Callable[..., Any], connection: Any, request: Request) -> Response | None:
        """The answer to a request, None for a websocket: that of `then`, or why it is refused."""
        host = request.headers.get("Host", "")
        origin = request.headers.get("Origin")
        if reason := self._gate.stranger(host) or self._gate.refusal(origin, host):
            self.on_refused(reason)
            return _response(HTTPStatus.FORBIDDEN, f"{reason}\n")
        if self.access is not None:
            address = str((connection.remote_address or ("",))[0])
            if given := self.access.answer(request.path, request.headers, address):
                if given.reason:
                    self.on_refused(given.reason)
                return _response(given.status, given.body, given.headers)
        answer: Response | None = then(connection, request)
        if answer is None:
            return None
        if not self.is_framed:
            only_framed_here(answer, is_public=self.access is not None)
        return connecting_in_frames(answer)


@contextmanager
def guarding(guard: Guard) -> Iterator[None]:
    """Make the server that viser starts meanwhile ask this guard.

    viser passes on neither headers nor `origins` nor `ssl`, so it gets a `serve` that does. The
    guard stands once that was called: a viser that starts its server in another way does not ask.
    """
    serve = server.serve
    tls = {} if guard.access is None else {"ssl": guard.access.tls.context}

    def guarded(*args: Any, process_request: Callable[..., Any], **options: Any) -> server.serve:
        guard.stands = True
        checked = partial(guard.check, process_request)
        return serve(*args, process_request=checked, **(options | tls))

    # viser only calls it: a function does for the class.
    server.serve = guarded  # type: ignore[assignment, misc]  # a class for mypy
    try:
        yield
    finally:
        server.serve = serve  # type: ignore[misc]  # the same


def _response(status: HTTPStatus, body: str, headers: Collection[tuple[str, str]] = ()) -> Response:
    return Response(status.value, status.phrase, Headers(headers), body.encode())


def connecting_in_frames(response: Response) -> Response:
    """The response; a page of HTML with a script that makes it connect in a frame, too."""
    headers = response.headers
    if not headers.get("Content-Type", "").startswith("text/html") or not response.body:
        return response
    is_packed = headers.get("Content-Encoding") == "gzip"
    response.body = _with_script(bytes(response.body), is_packed)
    if "Content-Length" in headers:
        del headers["Content-Length"]
        headers["Content-Length"] = str(len(response.body))
    return response


def only_framed_here(response: Response, *, is_public: bool) -> None:
    """Let no page of another machine frame it: a click on that one could be one on this.

    A page that others can reach is framed by itself only.
    """
    here = "" if is_public else " http://localhost:* http://127.0.0.1:*"
    response.headers["Content-Security-Policy"] = f"frame-ancestors 'self'{here}"


# Several megabytes, the same for all.
@lru_cache(4)
def _with_script(body: bytes, is_packed: bool) -> bytes:
    page = gzip.decompress(body) if is_packed else body
    page = page.replace(_HEAD, _HEAD + _SCRIPT, 1)
    return gzip.compress(page, 6) if is_packed else page
