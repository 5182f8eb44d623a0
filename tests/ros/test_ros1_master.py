"""The client of ROS 1's XML-RPC at other servers than a master."""

import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import Any
from xmlrpc.server import SimpleXMLRPCServer

import pytest

from tests.buses import DEADLINE_S
from tfbus.ros.ros1 import Ros1Master, Ros1State

PAGE = b"HTTP/1.0 200 OK\r\nContent-Type: text/html\r\n\r\n<html><p>Hello<br></html>"
NO_PAGE = b"HTTP/1.0 404 Not Found\r\n\r\nnone"
SSH = b"SSH-2.0-OpenSSH_9.2\r\n"
FAULT = b"HTTP/1.0 200 OK\r\n\r\n<methodResponse><fault></fault></methodResponse>"


@pytest.fixture
def server() -> Iterator[Callable[[bytes], str]]:
    """Starts a server that answers one connection with some bytes; its URI."""
    with ExitStack() as opened:

        def start(answer: bytes) -> str:
            listening = opened.enter_context(socket.create_server(("127.0.0.1", 0)))

            def serve() -> None:
                connection, _ = listening.accept()
                with connection:
                    connection.recv(65536)
                    connection.sendall(answer)
                    connection.shutdown(socket.SHUT_WR)
                    while connection.recv(65536):
                        pass

            thread = threading.Thread(target=serve)
            thread.start()
            opened.callback(thread.join)
            return f"http://127.0.0.1:{listening.getsockname()[1]}"

        yield start


@pytest.mark.parametrize("answer", [PAGE, NO_PAGE, SSH, FAULT, b""])
@pytest.mark.real
def test_another_server_is_an_os_error(server: Callable[[bytes], str], answer: bytes) -> None:
    """Whatever it answers, the caller has one kind of error to expect."""
    with pytest.raises(OSError):
        Ros1Master(server(answer), "/test").call("getPid")


@pytest.mark.parametrize(
    "uri",
    ["", "localhost", "localhost:11311", "ftp://localhost", "http://", "http://[",
     "http://localhost:abc", "http://localhost:99999", "http://a..b:1", "http://a b:1"],
)  # fmt: skip
def test_what_is_no_uri_is_said(uri: str) -> None:
    """With an example."""
    with pytest.raises(OSError, match=r"URI .*http://localhost:11311"):
        Ros1Master(uri, "/test")


def answering(answer: Any) -> Ros1State:
    """The state by a master that answers this."""
    with SimpleXMLRPCServer(("127.0.0.1", 0), logRequests=False) as server:
        server.register_function(lambda caller: answer, "getSystemState")
        thread = threading.Thread(target=server.handle_request)
        thread.start()
        try:
            uri = f"http://127.0.0.1:{server.server_address[1]}"
            return Ros1Master(uri, "/test", DEADLINE_S).state()
        finally:
            thread.join()


@pytest.mark.real
def test_the_state_of_a_master_is_by_topic() -> None:
    """Who publishes, who subscribes, and who offers services."""
    state = answering([1, "", [[["/tf", ["/a", "/b"]]], [["/tf", ["/c"]]], []]])
    assert state == Ros1State({"/tf": ["/a", "/b"]}, {"/tf": ["/c"]}, {})


@pytest.mark.parametrize("answer", [[1, "", 7], [1, "", []], [1, "", [[1], [], []]], [0, "no", 0]])
@pytest.mark.real
def test_another_state_is_an_os_error(answer: Any) -> None:
    """As of a program that has the method by chance."""
    with pytest.raises(OSError):
        answering(answer)
