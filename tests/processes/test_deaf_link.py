"""A process that opens a link as the time for that ends: Zenoh never reads it.

Once Zenoh does, the process has nothing to say here and the test fails: it goes then, with
`tfbus/bus/deaf_links.py`.
"""

import signal
import socket
import struct
import threading
import time
from collections.abc import Iterator
from contextlib import closing, suppress
from pathlib import Path

import pytest

from tests.buses import eventually
from tests.live_bus import Bus, Process, free_port

pytestmark = pytest.mark.real

_OPEN_S = 1.0


class Proxy:
    """Passes on all between clients and a router. With a `client`, the router's first answer comes
    to that shortly before its time to open a link ends, and the second one while it stands still.
    """

    def __init__(self, router: int) -> None:
        self._router = ("127.0.0.1", router)
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port = self._server.getsockname()[1]
        self.client: Process | None = None
        self._joined: list[socket.socket] = []
        threading.Thread(target=self._accept, daemon=True).start()

    def close(self) -> None:
        """Take no more links, and end all."""
        self._server.close()
        self.cut()

    def cut(self) -> None:
        """End all links."""
        for each in self._joined:
            with suppress(OSError):
                each.shutdown(socket.SHUT_RDWR)

    def _cut_last(self, near: socket.socket) -> None:
        """End a link that the client did open, if it tries no other one."""
        if self.client and self._joined[-2] is near:
            self.cut()

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                near = self._server.accept()[0]
                far = socket.create_connection(self._router)
                self._joined += [near, far]
                threading.Thread(target=_pass_on, args=(near, far), daemon=True).start()
                threading.Thread(target=self._answer, args=(far, near), daemon=True).start()

    def _answer(self, far: socket.socket, near: socket.socket) -> None:
        with suppress(OSError, struct.error):
            if client := self.client:
                first = _message(far)
                time.sleep(0.6 * _OPEN_S)
                near.sendall(first)
                second = _message(far)
                client.signal(signal.SIGSTOP)
                near.sendall(second)
                time.sleep(0.6 * _OPEN_S)
                client.signal(signal.SIGCONT)
                threading.Timer(2.0 * _OPEN_S, self._cut_last, (near,)).start()
        _pass_on(far, near)


def _message(one: socket.socket) -> bytes:
    length = one.recv(2, socket.MSG_WAITALL)
    return length + one.recv(*struct.unpack("<H", length), socket.MSG_WAITALL)


def _pass_on(one: socket.socket, other: socket.socket) -> None:
    with suppress(OSError):
        while some := one.recv(65536):
            other.sendall(some)
        other.shutdown(socket.SHUT_RDWR)


@pytest.fixture
def proxy(bus: Bus) -> Iterator[Proxy]:
    """A proxy before a router, at another port."""
    port = free_port()
    router = bus.start("router", "--listen", f"tcp/127.0.0.1:{port}", env={"TFBUS_CONNECT": ""})
    router.wait_for_line("Routing on")
    with closing(Proxy(port)) as one:
        yield one


def test_a_link_that_is_never_read_is_opened_anew(bus: Bus, proxy: Proxy, tmp_path: Path) -> None:
    """A process that did not run as its link was opened says so, and answers again."""
    config = tmp_path / "zenoh.json5"
    config.write_text(f"{{transport: {{unicast: {{open_timeout: {_OPEN_S * 1e3:.0f}}}}}}}")
    through = {"TFBUS_MODE": "client", "TFBUS_CONNECT": f"tcp/127.0.0.1:{proxy.port}"}
    robot = bus.start(
        "static", "map", "base", "--name", "mount", env={**through, "TFBUS_CONFIG": str(config)}
    )
    robot.wait_for_line("ready")

    proxy.client = robot
    proxy.cut()
    robot.wait_for_line("was read since it was opened")
    proxy.client = None
    eventually(
        lambda: "Translation" in bus.run("echo", "map", "base", "--once", env=through).stdout
    )
