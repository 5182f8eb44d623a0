"""The page over a link with a long way: a handshake takes longer than viser's pause between two."""

import socket
import threading
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import pytest

from tests.live_bus import free_port
from tests.view.pages import View, eventually
from tfbus import Buffer, Transform, TransformStamped
from tfbus.view import show

pytestmark = pytest.mark.real

_WAY_S = 1.5


class Link:
    """Passes connections on to a port of this machine, those of WebSockets `_WAY_S` late; the first
    of these it cuts, as a link that breaks does.
    """

    def __init__(self, port: int) -> None:
        self._to = ("127.0.0.1", port)
        self._ended = threading.Event()
        self._is_cut = False
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        threading.Thread(target=self._accept, daemon=True).start()

    def close(self) -> None:
        self._ended.set()
        self._listener.close()

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                browser, _ = self._listener.accept()
                threading.Thread(target=self._pass_on, args=(browser,), daemon=True).start()

    def _pass_on(self, browser: socket.socket) -> None:
        with browser, suppress(OSError), socket.create_connection(self._to) as page:
            first = browser.recv(65536)
            if b"Upgrade: websocket" in first:
                if not self._is_cut:
                    self._is_cut = True
                    return
                self._ended.wait(_WAY_S)
            page.sendall(first)
            threading.Thread(target=_copy, args=(browser, page), daemon=True).start()
            _copy(page, browser)


def _copy(one: socket.socket, other: socket.socket) -> None:
    with suppress(OSError):
        while data := one.recv(65536):
            other.sendall(data)
    for each in (one, other):
        with suppress(OSError):
            each.shutdown(socket.SHUT_RDWR)


@pytest.fixture
def link() -> Iterator[tuple[Link, Any]]:
    """The link, and a view behind it."""
    pytest.importorskip("viser", reason="needs viser: the extra view")
    buffer = Buffer()
    buffer.set_transform(TransformStamped(1_000_000_000, "map", "base", Transform((1.0, 0.0, 0.0))))
    with show(buffer, port=free_port(), rate_hz=5.0) as shown:
        link = Link(int(shown.url.rpartition(":")[2]))
        yield link, shown
        link.close()


def test_a_browser_connects_over_a_slow_link(link: tuple[Link, Any], pages: Any) -> None:
    """It lets a handshake end before it begins another."""
    slow, shown = link
    view = View(pages.new_page(), f"http://127.0.0.1:{slow.port}/")
    eventually(lambda: shown.is_watched)
    view.wait_for_status("base", "dynamic")
