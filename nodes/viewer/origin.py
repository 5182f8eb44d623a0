"""Who may speak to the page: browsers that were given it from here, and programs.

A browser lets any web page open a websocket to this machine, and tells only in the header Origin
which page it was; so that one is compared with where it was sent to. Where only this machine can
reach the view, that has to be one of its own names too: whoever owns a name can let it point here.
"""

import ipaddress
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from http import HTTPStatus
from typing import Any
from urllib.parse import urlsplit

from websockets.asyncio import server
from websockets.datastructures import Headers
from websockets.http11 import Request, Response


def is_local(host: str) -> bool:
    """Whether a host, a name or an address, is only this machine."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def refusal(headers: Mapping[str, str], listens_locally: bool) -> str:
    """Why a request with these headers is not served, in a sentence; "" where it is."""
    host, origin = headers.get("Host", ""), headers.get("Origin")
    name = urlsplit(f"//{host}").hostname or ""
    if listens_locally and not is_local(name):
        return f"the view listens for this machine alone, and is not {name!r}: open localhost"
    if origin is not None and urlsplit(origin).netloc != host:
        return f"a page of {origin!r} may not speak to the view at {host!r}: open that itself"
    return ""


@contextmanager
def guarding(listens_locally: bool) -> Iterator[None]:
    """Let the server that viser starts meanwhile refuse others.

    viser hands neither headers nor `origins` on, so it is given a `serve` that looks at them.
    """
    serve = server.serve

    def guarded(*args: Any, process_request: Callable[..., Any], **options: Any) -> server.serve:
        checked = partial(_check, process_request, listens_locally)
        return serve(*args, process_request=checked, **options)

    # As what it is used for: a function that makes a server.
    server.serve = guarded  # type: ignore[assignment, misc]
    try:
        yield
    finally:
        server.serve = serve  # type: ignore[misc]


def _check(
    then: Callable[..., Any], listens_locally: bool, connection: Any, request: Request
) -> Response | None:
    reason = refusal(request.headers, listens_locally)
    if not reason:
        answer: Response | None = then(connection, request)
        return answer
    status = HTTPStatus.FORBIDDEN
    return Response(status.value, status.phrase, Headers(), f"{reason}\n".encode())
