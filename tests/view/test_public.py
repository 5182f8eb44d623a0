"""`tfbus view --public`: the page in a real Chromium, and others' access to it."""

import base64
import http.client
import ssl
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest

from tests.buses import DEADLINE_S
from tests.live_bus import Bus, Process, free_port
from tests.view.pages import PATIENCE_S, Arm, View, window_of

pytest.importorskip("viser", reason="needs viser: the extra view")
pytest.importorskip("cryptography", reason="needs cryptography: pip install cryptography")

import viser

ELSEWHERE = """<!doctype html><p id="said">waiting</p><script>
const socket = new WebSocket('{address}', 'viser-v{version}');
socket.onopen = () => {{ said.innerText = 'connected'; }};
socket.onerror = () => {{ said.innerText = 'refused'; }};
</script>"""


def public_view(bus: Bus, *options: str, env: dict[str, str] | None = None) -> tuple[Process, str]:
    """A view that others reach, and the address that it prints, at this machine."""
    arguments = ("view", "--public", "--port", str(free_port()), "--rate", "5", *options)
    process = bus.start(*arguments, env=env)
    line = process.wait_for_line(r"View: https://", timeout_s=PATIENCE_S)
    printed = urlsplit(line.split("View: ")[1].split(" ")[0])
    query = f"/?{printed.query}" if printed.query else "/"
    return process, f"https://127.0.0.1:{printed.port}{query}"


@pytest.fixture(scope="module")
def public(real: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Process, str]]:
    """A view that others reach, for all tests that change nothing of it, and its address."""
    with closing(Bus(tmp_path_factory.mktemp("bus"))) as bus:
        yield public_view(bus)


def unchecked() -> ssl.SSLContext:
    """For certificates of any authority."""
    context = ssl.create_default_context()
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    return context


def ask(address: str, path: str = "", **headers: str) -> http.client.HTTPResponse:
    """The answer to a request for a path, by default that of the address."""
    parts = urlsplit(address)
    assert parts.netloc
    connection = http.client.HTTPSConnection(parts.netloc, timeout=DEADLINE_S, context=unchecked())
    connection.request("GET", path or f"{parts.path}?{parts.query}", headers=headers)
    return connection.getresponse()


def cookie_of(address: str) -> str:
    """The cookie that who has the printed address gets."""
    return str(ask(address).headers["Set-Cookie"]).partition(";")[0]


def opening(address: str, **headers: str) -> int:
    """The status of the answer to a websocket with these headers; 101 opens it.

    Not by the client of websockets: it reads and writes on two threads, which OpenSSL does not
    bear, and now and then reads an end in place of the answer.
    """
    key = base64.b64encode(bytes(16)).decode()
    asked = {
        "Connection": "Upgrade",
        "Upgrade": "websocket",
        "Sec-WebSocket-Version": "13",
        "Sec-WebSocket-Key": key,
        "Sec-WebSocket-Protocol": f"viser-v{viser.__version__}",
    }
    return ask(address, "/", **asked, **headers).status


@contextmanager
def served(text: str) -> Iterator[str]:
    """The origin of a server of this page."""

    class Pages(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("Content-Type", "text/html")
            self.end_headers()
            self.wfile.write(text.encode())

        def log_message(self, *values: object) -> None:
            """Say nothing."""

    with ThreadingHTTPServer(("127.0.0.1", 0), Pages) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            yield f"http://127.0.0.1:{server.server_port}"
        finally:
            server.shutdown()
            thread.join()


@pytest.fixture
def strangers(browser: Any) -> Iterator[Any]:
    """A window of a browser that takes certificates of unknown authorities."""
    with window_of(browser, ignore_https_errors=True) as window:
        yield window


def test_a_browser_needs_the_token(bus: Bus, strangers: Any) -> None:
    """Without it there is a form, which says a wrong one; with it the page lives."""
    Arm(bus.node("arm"))
    _, address = public_view(bus, env={"TFBUS_VIEW_TOKEN": "correct horse"})
    page = strangers.new_page()
    page.goto(address)
    page.get_by_label("token").fill("battery staple")
    page.get_by_role("button", name="Open").click()
    page.get_by_role("alert").filter(has_text="That is not the token.").wait_for()
    page.get_by_label("token").fill("correct horse")
    page.get_by_role("button", name="Open").click()
    page.get_by_role("status").filter(has_text="4 frames, seen from map").wait_for()
    assert page.url == address
    page.get_by_text("View", exact=True).click()
    page.get_by_text("This page is read-only").wait_for()
    assert page.get_by_role("button", name="Save settings").count() == 0


def test_the_printed_address_opens_the_page(bus: Bus, strangers: Any) -> None:
    """The token is then no longer in the address; --operate lets a browser save settings."""
    _, address = public_view(bus, "--operate")
    view = View(strangers.new_page(), address)
    assert "token" in address and view.page.url == address.partition("?")[0]
    view.tab("View")
    view.page.get_by_role("button", name="Save settings").wait_for()


def test_a_page_from_elsewhere_cannot_connect(public: tuple[Process, str], strangers: Any) -> None:
    """Not even in a browser that has the page open, from another port of the same machine."""
    process, address = public
    View(strangers.new_page(), address)
    text = ELSEWHERE.format(address=f"wss://{urlsplit(address).netloc}/", version=viser.__version__)
    with served(text) as origin:
        evil = strangers.new_page()
        evil.goto(origin)
        evil.locator("#said").filter(has_text="refused").wait_for()
    process.wait_for_line(f"Refused a browser: a page of '{origin}' may not connect")


def test_a_websocket_needs_the_cookie_and_the_origin(public: tuple[Process, str]) -> None:
    """A program has the one by the token; a page of another origin is refused with both."""
    process, address = public
    host = urlsplit(address).netloc
    assert opening(address) == 401
    assert opening(address, Cookie="__Host-tfbus-view=nonsense") == 401
    cookie = cookie_of(address)
    assert opening(address, Cookie=cookie) == 101
    assert opening(address, Cookie=cookie, Origin=f"https://{host}") == 101
    assert opening(address, Cookie=cookie, Origin="https://evil.example") == 403
    process.wait_for_line(r"Refused a browser: a page of 'https://evil\.example' may not connect")


def test_every_path_needs_the_token_and_leads_to_the_page_only(public: tuple[Process, str]) -> None:
    """No file of the machine is served, with the token or without."""
    process, address = public
    for path in ("/", "/index.html", "/%2e%2e/%2e%2e/etc/passwd", "/hdri/", "//["):
        assert ask(address, path).status == 401
    cookie = cookie_of(address)
    assert ask(address, "/index.html", Cookie=cookie).status == 200
    for path in ("/../../../etc/passwd", "/%2e%2e/%2e%2e/etc/passwd", "/..%5c..%5csetup.py"):
        assert ask(address, path, Cookie=cookie).status == 404
    assert ask(address, "/", Cookie=cookie, Host="evil.example").status == 403
    assert ask(address, "/?token=wrong").status == 401
    process.wait_for_line(r"Refused a browser: a wrong token from 127\.0\.0\.1")


def test_no_other_page_can_frame_it(public: tuple[Process, str]) -> None:
    """A click on that one could be a click on this."""
    _, address = public
    answer = ask(address, "/", Cookie=cookie_of(address))
    assert answer.headers["Content-Security-Policy"] == "frame-ancestors 'self'"


@pytest.mark.real
def test_a_certificate_of_ones_own_is_served(bus: Bus, tmp_path: Path) -> None:
    """Browsers that trust it connect without a warning, under its names."""
    from tfbus.bus.keystore import make_for_server

    made = make_for_server(["127.0.0.1", "robot.example"], 1.0)
    path = tmp_path / "robot.pem"
    path.write_bytes(made.certificate + made.key)
    _, address = public_view(bus, "--certificate", str(path))
    trusting = ssl.create_default_context(cadata=made.certificate.decode())
    parts = urlsplit(address)
    assert parts.netloc
    connection = http.client.HTTPSConnection(parts.netloc, timeout=DEADLINE_S, context=trusting)
    connection.request("GET", "/", headers={"Host": "robot.example"})
    assert connection.getresponse().status == 401


def test_a_picture_is_not_taken_of_a_public_page(bus: Bus) -> None:
    """Its browser would not have the token."""
    done = bus.run("view", "--public", "--screenshot", "out.png")
    assert done.returncode == 2
    assert "--screenshot and --public are" in done.stderr
