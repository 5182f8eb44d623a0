"""Pages and clients that may use the page: browsers that have it from here, and programs.

A browser lets any web page open a websocket to this machine; only the header Origin says which page
it was. So Origin must match Host. Host must be an address or one of this machine's own names: the
owner of any other name can let it point here.
"""

from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from http import HTTPStatus
from typing import Any
from urllib.parse import SplitResult, urlsplit

from websockets.asyncio import server
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from tfbus.runtime.addresses import address_of, is_local, own_names
from tfbus.view.access import Access
from tfbus.view.framed import connecting_in_frames, only_framed_here


def machine_names(host: str) -> frozenset[str]:
    """The names under which others may open a view that listens at `host`: that one, and this
    machine's host name with and without its domain; none if only this machine reaches it.
    """
    if is_local(host):
        return frozenset()
    return own_names() | {host.lower()}


def refusal(headers: Mapping[str, str], names: Collection[str]) -> str:
    """Why a request with these headers is refused, in a sentence; "" if it is served.

    `names` are those of `machine_names`.
    """
    host, origin = headers.get("Host", "").lower(), headers.get("Origin")
    name = _parts(f"//{host}").hostname or ""
    if not names and not is_local(name):
        return f"the view is for this machine only: open it as localhost, not as {name!r}"
    if names and not _is_own(name, names):
        return (
            f"the view is not {name or host!r}, a name that anyone could point here: open the IP "
            "address of its machine, its host name, or that with .local"
        )
    if origin is not None and _parts(origin.lower()).netloc != host:
        return f"a page of {origin!r} may not use the view at {host!r}: open the view directly"
    return ""


def _is_own(name: str, names: Collection[str]) -> bool:
    """Whether only this machine, or its own network, can let this name point here."""
    # Names in .local are resolved on the local network only (RFC 6762).
    return (
        name in names
        or f"*.{name.partition('.')[2]}" in names  # as a certificate may have it
        or is_local(name)
        or name.endswith(".local")
        or address_of(name) is not None
    )


def _parts(url: str) -> SplitResult:
    """The parts of a URL; all empty if it is malformed."""
    try:
        return urlsplit(url)
    except ValueError:
        return urlsplit("")


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
        self._names = machine_names(self.host)
        if self.access is not None:
            self._names |= own_names() | self.access.tls.names

    def check(self, then: Callable[..., Any], connection: Any, request: Request) -> Response | None:
        """The answer to a request, None for a websocket: that of `then`, or why it is refused."""
        if reason := refusal(request.headers, self._names):
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
