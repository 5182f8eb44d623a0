"""Who may use the page: browsers that have it from here, and programs.

A browser lets any web page open a websocket to this machine; only the header Origin says which page
it was. So Origin must match Host. Host must be an address or one of this machine's own names: the
owner of any other name can let it point here.
"""

import socket
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

from tfbus.runtime.addresses import address_of, is_local
from tfbus.view.framed import connecting_in_frames


def machine_names(host: str) -> frozenset[str]:
    """The names under which others may open a view that listens at `host`: that one, and this
    machine's host name with and without its domain; none if only this machine reaches it.
    """
    if is_local(host):
        return frozenset()
    full = socket.gethostname(), socket.getfqdn()
    return frozenset(name.lower() for name in (host, *full, full[0].partition(".")[0]))


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
        name in names or is_local(name) or name.endswith(".local") or address_of(name) is not None
    )


def _parts(url: str) -> SplitResult:
    """The parts of a URL; all empty if it is malformed."""
    try:
        return urlsplit(url)
    except ValueError:
        return urlsplit("")


@dataclass
class Guard:
    """`stands` once the server checks its requests."""

    stands: bool = False


@contextmanager
def guarding(host: str) -> Iterator[Guard]:
    """Make the server that viser starts meanwhile, to listen at `host`, refuse other origins.

    viser passes on neither headers nor `origins`, so it gets a `serve` that checks them. The guard
    stands once that was called: a viser that starts its server in another way is not checked.
    """
    serve, names, guard = server.serve, machine_names(host), Guard()

    def guarded(*args: Any, process_request: Callable[..., Any], **options: Any) -> server.serve:
        guard.stands = True
        checked = partial(_check, process_request, names)
        return serve(*args, process_request=checked, **options)

    # viser only calls it: a function does for the class.
    server.serve = guarded  # type: ignore[assignment, misc]  # a class for mypy
    try:
        yield guard
    finally:
        server.serve = serve  # type: ignore[misc]  # the same


def _check(
    then: Callable[..., Any], names: Collection[str], connection: Any, request: Request
) -> Response | None:
    reason = refusal(request.headers, names)
    if not reason:
        answer: Response | None = then(connection, request)
        return None if answer is None else connecting_in_frames(answer)
    status = HTTPStatus.FORBIDDEN
    return Response(status.value, status.phrase, Headers(), f"{reason}\n".encode())
