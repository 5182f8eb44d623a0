"""The port of Foxglove's clients: which of them the server serves."""

import logging
import socket
import ssl
from collections.abc import Iterator
from contextlib import ExitStack, suppress

import pytest

pytest.importorskip("websockets", reason="needs websockets: pip install websockets")
from websockets.datastructures import Headers
from websockets.exceptions import InvalidStatus
from websockets.http11 import Request, Response

from tests import needs
from tests.buses import DEADLINE_S, eventually
from tests.foxglove.client import Client
from tfbus.base.errors import TfbusError
from tfbus.foxglove.client import Requests
from tfbus.foxglove.front import MOST_CLIENTS, Front, Serving, page_url
from tfbus.foxglove.server import Server

ALLOWED = "http://viewer.lan:8080"


@pytest.fixture
def server() -> Iterator[Server]:
    """A server without channels."""
    server = Server("test", Requests(), [], logging.getLogger("test"))
    yield server
    server.close()


@pytest.fixture
def front(server: Server) -> Iterator[Front]:
    """The port in front of it."""
    front = Front(Serving(port=0, origins=(ALLOWED,)), server, lambda reason: None)
    yield front
    front.close()


def is_let_in(port: int, origin: str | None) -> bool:
    """Whether a page of this origin gets a websocket."""
    try:
        with Client(port, origin=origin):
            return True
    except InvalidStatus as refused:
        assert refused.response.status_code == 403
        return False


# Web pages, and whether they may use a server of this machine that listens for it alone.
PAGES = {
    None: True,
    "http://localhost:8080": True,
    "http://LOCALHOST": True,
    "http://127.0.0.1:3000": True,
    "https://[::1]:3000": True,
    "file://": True,
    "app://foxglove": True,
    "https://evil.example": False,
    "http://viewer.lan": False,
    "http://localhost.evil.example": False,
    "http://127.0.0.1.evil.example": False,
    "http://0x7f.1": False,
    "null": False,
    "http://[": False,
}


def test_the_view_and_foxglove_let_the_same_pages_in(front: Front) -> None:
    """Pages of this machine and applications may connect, and pages of its own."""
    served = Response(200, "OK", Headers())
    server = pytest.importorskip("tfbus.view.server", reason="needs viser: the extra view")
    guard = server.Guard("127.0.0.1")
    for origin, is_welcome in PAGES.items():
        headers = Headers(
            {"Host": "127.0.0.1:8080"} | ({} if origin is None else {"Origin": origin})
        )
        answer = guard.check(lambda *_: served, None, Request("/", headers))
        assert (answer is served, is_let_in(front.port, origin)) == (is_welcome,) * 2, origin


def test_pages_of_foxglove_and_allowed_ones_are_let_in(front: Front) -> None:
    """Over TLS, and under their whole names."""
    for origin in ("https://app.foxglove.dev", "https://foxglove.dev", ALLOWED):
        assert is_let_in(front.port, origin)
    for origin in (
        "http://app.foxglove.dev",
        "https://foxglove.dev.evil.example",
        "https://notfoxglove.dev",
    ):
        assert not is_let_in(front.port, origin)


def test_a_client_is_passed_on(front: Front) -> None:
    """It speaks with Foxglove's server."""
    with Client(front.port) as client:
        info = eventually(lambda: client.texts_of("serverInfo"))
        assert info[0]["name"] == "test"
        assert front.clients == 1
    eventually(lambda: front.clients == 0)


def test_a_page_of_another_host_is_refused_by_the_server(server: Server) -> None:
    """With 403, and the reason goes to the log."""
    reasons: list[str] = []
    front = Front(Serving(port=0), server, reasons.append)
    try:
        with pytest.raises(InvalidStatus, match="403"):
            Client(front.port, origin="https://evil.example")
        assert len(reasons) == 1 and "https://evil.example" in reasons[0]
    finally:
        front.close()


@pytest.mark.real
def test_a_browser_gets_a_text_that_says_where_to_go(front: Front) -> None:
    """The address is one that people try in a browser."""
    with socket.create_connection(("127.0.0.1", front.port), DEADLINE_S) as client:
        client.sendall(b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n")
        answer = b"".join(iter(lambda: client.recv(4096), b"")).decode()
    assert answer.startswith("HTTP/1.1 426 ")
    assert page_url(front.addresses[0]) in answer


@pytest.mark.real
@pytest.mark.parametrize("garbage", [b"\x00" * 40_000, b"GET / HTTP/1.1\r\n", b""])
def test_garbage_harms_no_other_client(front: Front, garbage: bytes) -> None:
    """What is no request, or ends early, is dropped."""
    with socket.create_connection(("127.0.0.1", front.port), DEADLINE_S) as client:
        assert is_dropped(client, garbage)
    with Client(front.port) as other:
        eventually(lambda: other.texts_of("serverInfo"))


def is_dropped(client: socket.socket, garbage: bytes) -> bool:
    """Whether the connection is ended without an answer; by a reset where a part of the garbage
    comes after the end.
    """
    try:
        client.sendall(garbage)
        client.shutdown(socket.SHUT_WR)
        return client.recv(4096) == b""
    except TimeoutError:
        return False
    except OSError:
        return True


@pytest.mark.real
def test_requests_that_are_never_sent_shut_nobody_out(
    front: Front, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Connections that are held open without a request give way to newcomers, the oldest first."""
    # None of them is answered that its time is over.
    monkeypatch.setattr("tfbus.foxglove.front._PATIENCE_S", DEADLINE_S)
    held = []
    try:
        for _ in range(3 * MOST_CLIENTS):
            held.append(socket.create_connection(("127.0.0.1", front.port), DEADLINE_S))
            held[-1].sendall(b"GET / HTTP/1.1\r\n")
        with Client(front.port) as client:
            eventually(lambda: client.texts_of("serverInfo"))
            assert front.clients == 1
        held[0].settimeout(DEADLINE_S)
        with suppress(ConnectionResetError):
            assert held[0].recv(1) == b""
    finally:
        for each in held:
            each.close()


def test_there_is_a_limit_of_clients(front: Front) -> None:
    """Further clients are told, and let in once there is room."""
    with ExitStack() as all_of_them:
        for _ in range(MOST_CLIENTS):
            all_of_them.enter_context(Client(front.port))
        with pytest.raises(InvalidStatus, match="503"):
            Client(front.port)
    eventually(lambda: front.clients == 0)
    with Client(front.port) as client:
        eventually(lambda: client.texts_of("serverInfo"))


@pytest.mark.real
def test_a_request_for_another_protocol_is_refused(front: Front) -> None:
    """With 400: a WebSocket of something else."""
    with socket.create_connection(("127.0.0.1", front.port), DEADLINE_S) as client:
        client.sendall(
            b"GET / HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            b"Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nSec-WebSocket-Version: 13\r\n"
            b"Sec-WebSocket-Protocol: mqtt\r\n\r\n"
        )
        assert b"".join(iter(lambda: client.recv(4096), b"")).startswith(b"HTTP/1.1 400 ")


@pytest.mark.real
def test_a_taken_port_is_followed_by_the_next(server: Server) -> None:
    """And that is said."""
    first = Front(Serving(port=0), server, lambda reason: None)
    second = Front(Serving(port=first.port), server, lambda reason: None)
    try:
        assert second.port > first.port
        assert f"port {first.port} of 127.0.0.1 is taken" in second.warnings()[0]
    finally:
        first.close()
        second.close()


@pytest.mark.real
def test_a_host_that_is_not_here_is_an_error(server: Server) -> None:
    """One sentence, with the address."""
    with pytest.raises(TfbusError, match=r"could not listen at 192\.0\.2\.1:8765"):
        Front(Serving(host="192.0.2.1"), server, lambda reason: None)
    with pytest.raises(TfbusError, match=r"could not listen at 10\.0\.\.7:8765: no host has"):
        Front(Serving(host="10.0..7"), server, lambda reason: None)


@pytest.mark.real
def test_one_that_others_reach_needs_its_token(server: Server) -> None:
    """Over TLS; wrong ones are refused and said, and after 10 from an address all are."""
    needs.module("cryptography")
    from tfbus.command.server_access import AccessToken, made_tls

    reasons: list[str] = []
    token = AccessToken("correct horse")
    serving = Serving("127.0.0.1", 0, tls=made_tls("127.0.0.1"), token=token)
    front = Front(serving, server, reasons.append)
    context = ssl.create_default_context()
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE

    def client(query: str) -> Client:
        return Client(front.port, query=query, ssl=context)

    try:
        with client("/?token=correct%20horse"):
            pass
        for query in ("/", "/?token=wrong"):
            with pytest.raises(InvalidStatus, match="401"):
                client(query)
        assert reasons == ["a wrong token from 127.0.0.1"]
        for _ in range(9):
            token.judge("wrong", "127.0.0.1")
        with pytest.raises(InvalidStatus, match="429"):
            client("/?token=correct%20horse")
    finally:
        front.close()


@pytest.mark.real
def test_the_token_is_in_an_address_but_in_no_link(server: Server) -> None:
    """A link would carry it to Foxglove's site; one that was given is not printed."""
    needs.module("cryptography")
    from tfbus.command.server_access import AccessToken, made_tls

    for token in (AccessToken(), AccessToken("correct horse")):
        serving = Serving("127.0.0.1", 0, tls=made_tls("127.0.0.1"), token=token)
        front = Front(serving, server, lambda reason: None)
        shown = token.text if token.is_new else "…"
        said = f"Foxglove: connect to wss://127.0.0.1:{front.port}/?token={shown}"
        assert front.announcement() == said
        front.close()


def test_the_link_opens_foxglove_at_the_address() -> None:
    """As Foxglove documents it, in a browser or its application."""
    assert page_url("ws://localhost:8765") == (
        "https://app.foxglove.dev/?ds=foxglove-websocket&ds.url=ws%3A%2F%2Flocalhost%3A8765"
    )
    assert page_url("ws://localhost:8765", desktop=True) == (
        "foxglove://open?ds=foxglove-websocket&ds.url=ws%3A%2F%2Flocalhost%3A8765"
    )
