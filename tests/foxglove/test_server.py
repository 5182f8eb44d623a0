"""Foxglove's server, while clients come, go, and do not read."""

import logging
import os
import socket
import struct
import threading
from collections.abc import Iterator

import pytest

pytest.importorskip("websockets", reason="needs websockets: pip install websockets")

from tests.buses import DEADLINE_S, eventually
from tests.foxglove.client import Client
from tfbus.foxglove.client import BACKLOG, Requests
from tfbus.foxglove.front import Front, Serving
from tfbus.foxglove.nodes import Connections
from tfbus.foxglove.protocol import Capability, PlaybackState, PlaybackStatus, ShownParameter
from tfbus.foxglove.server import ServedChannel, ServedService, Server

# A client that asks for a WebSocket and then reads nothing.
UPGRADE = (
    b"GET / HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    b"Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nSec-WebSocket-Version: 13\r\n"
    b"Sec-WebSocket-Protocol: foxglove.sdk.v1\r\n\r\n"
)


class Knows(Requests):
    """Knows any parameter, and sets it."""

    def get_parameters(self, names: list[str]) -> list[ShownParameter]:  # type: ignore[override]
        return [ShownParameter(name, 1) for name in names]

    def set_parameters(self, given: list[ShownParameter]) -> list[ShownParameter]:  # type: ignore[override]
        return given


@pytest.fixture
def server() -> Iterator[Server]:
    capabilities = [Capability.GRAPH, Capability.PARAMETERS, Capability.SERVICES]
    server = Server("test", Knows(), capabilities, logging.getLogger("test"))
    yield server
    server.close()


@pytest.fixture
def front(server: Server) -> Iterator[Front]:
    front = Front(Serving(port=0), server, lambda reason: None)
    yield front
    front.close()


@pytest.mark.real
def test_clients_come_and_go_while_all_is_published(server: Server, front: Front) -> None:
    """No moment of a client's stops the publisher, nor the publisher a client."""
    is_ended = threading.Event()
    rounds = 0

    def publish() -> None:
        nonlocal rounds
        while not is_ended.is_set():
            rounds += 1
            server.publish_graph(Connections({f"/topic{rounds % 7}": ["/node"]}))
            server.publish_parameters([ShownParameter("/node.a", rounds)])
            server.say("no")
            channel = server.open_channel(f"/topic{rounds % 7}", "json")
            channel.send(b"{}", rounds)
            channel.close()
            is_ended.wait(0.001)

    publisher = threading.Thread(target=publish)
    publisher.start()
    try:
        for _ in range(30):
            with Client(front.port) as client:
                client.send("subscribeConnectionGraph")
                client.send("subscribeParameterUpdates", parameterNames=["/node.a", "/node.b"])
                eventually(lambda client=client: client.published and client.parameters)  # type: ignore[misc]
                client.send("unsubscribeConnectionGraph")
                client.send("unsubscribeParameterUpdates", parameterNames=["/node.a"])
        before = rounds
        eventually(lambda: rounds > before)
    finally:
        is_ended.set()
        publisher.join(DEADLINE_S)
    assert not publisher.is_alive()


def test_the_graph_comes_whole_and_then_what_changes(server: Server, front: Front) -> None:
    """A topic that has lost all its publishers but not its subscribers has none of them."""
    server.publish_graph(Connections({"/a": ["/x"], "/b": ["/x"]}, {"/a": ["/y"]}, {"/s": ["/x"]}))
    with Client(front.port) as client:
        client.send("subscribeConnectionGraph")
        eventually(lambda: client.published.get("/b") == ["/x"])
        server.publish_graph(Connections({}, {"/a": ["/y"]}, {}))
        eventually(lambda: client.published.get("/a") == [])
        last = client.texts_of("connectionGraphUpdate")[-1]
        assert last["removedTopics"] == ["/b"]
        assert last["removedServices"] == ["/s"]
        assert last["subscribedTopics"] == []


@pytest.mark.real
def test_one_that_reads_nothing_holds_up_nobody(server: Server, front: Front) -> None:
    """It loses the oldest messages; one that reads gets all that it takes."""
    channel = server.open_channel("/topic", "json")
    with socket.create_connection(("127.0.0.1", front.port), DEADLINE_S) as deaf:
        _subscribe(deaf, channel)
        with Client(front.port) as client:
            client.subscribe("/topic")
            eventually(lambda: len(channel.subscribers) == 2)
            big = b"0" * 100_000
            for number in range(5 * BACKLOG // 2):
                channel.send(big if number % 10 else b"small", number)
            channel.send(b"last", 0)
            eventually(lambda: b"last" in client.of("/topic"))
        eventually(lambda: front.clients == 1)


def test_a_client_with_a_wrong_id_harms_no_other(server: Server, front: Front) -> None:
    """An id that no message can carry is refused, and others get what is sent."""
    channel = server.open_channel("/topic", "json")
    with Client(front.port) as wrong, Client(front.port) as client:
        wrong.send("subscribe", subscriptions=[{"id": 1 << 40, "channelId": channel.id}])
        eventually(wrong.said)
        client.subscribe("/topic")
        eventually(lambda: channel.is_watched)
        channel.send(b"{}", 1)
        eventually(lambda: client.of("/topic"))


@pytest.mark.real
def test_one_that_ends_without_reading_harms_no_newcomer(
    server: Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its connection is ended after a while, and the next one gets the number of its socket."""
    front = Front(Serving(port=0), server, lambda reason: None)
    channel = server.open_channel("/topic", "json")
    try:
        # Made before, so that the number is left to the server's end.
        with socket.socket() as newcomer, socket.socket() as deaf:
            before = _open_files()
            deaf.connect(("127.0.0.1", front.port))
            _subscribe(deaf, channel)
            for number in range(500):
                channel.send(b"0" * 100_000, number)
            # Only with its end: a request may take its time.
            with monkeypatch.context() as hurried:
                hurried.setattr("tfbus.foxglove.front._PATIENCE_S", 0.2)
                deaf.shutdown(socket.SHUT_WR)
                # What another test left may be closed meanwhile.
                eventually(lambda: _open_files() <= before)
            newcomer.settimeout(DEADLINE_S)
            newcomer.connect(("127.0.0.1", front.port))
            newcomer.sendall(UPGRADE)
            assert newcomer.recv(12) == b"HTTP/1.1 101"
    finally:
        front.close()


@pytest.mark.real
@pytest.mark.parametrize("is_told", [True, False])
def test_what_waits_for_a_client_is_limited_in_bytes(
    monkeypatch: pytest.MonkeyPatch, server: Server, front: Front, is_told: bool
) -> None:
    """Large messages of topics drop the oldest earlier; of others, as files, the client ends."""
    monkeypatch.setattr("tfbus.foxglove.client._MOST_SENT", 10_000_000)
    monkeypatch.setattr("tfbus.foxglove.client._MOST_TOLD", 10_000_000)
    channel = server.open_channel("/topic", "json")
    with socket.create_connection(("127.0.0.1", front.port), DEADLINE_S) as deaf:
        _subscribe(deaf, channel)
        [(connection, _)] = channel.subscribers
        for _ in range(100):
            (connection.tell if is_told else connection.send)(bytes(1_000_000))
        if is_told:
            eventually(lambda: front.clients == 0)
            return
        connection.send(b"last")
        got, end = 0, b""
        while b"last" not in end:
            data = deaf.recv(1 << 20)
            got, end = got + len(data), end[-4:] + data
        assert got < 50_000_000


def _open_files() -> int:
    return len(os.listdir("/dev/fd"))


def _subscribe(client: socket.socket, channel: ServedChannel) -> None:
    """Have a client without a reader subscribe to a channel."""
    wish = b'{"op":"subscribe","subscriptions":[{"id":1,"channelId":%d}]}' % channel.id
    client.sendall(UPGRADE + _masked(wish))
    eventually(lambda: channel.is_watched)


def test_the_state_of_a_recording_comes_after_its_messages(server: Server, front: Front) -> None:
    """A client that learns of the end has all that was sent before."""
    channel = server.open_channel("/topic", "json")
    with Client(front.port) as client:
        client.subscribe("/topic")
        eventually(lambda: channel.is_watched)
        for number in range(50):
            for _ in range(20):
                channel.send(b"{}", number)
            server.tell_playback(PlaybackState(PlaybackStatus.ENDED, number, 1.0))
            eventually(lambda number=number: len(client.playback) > number)  # type: ignore[misc]
            assert len(client.of("/topic")) == 20 * (number + 1)


def _masked(text: bytes) -> bytes:
    """A text message of a client, with the mask 0."""
    return struct.pack(">BBH4x", 0x81, 0x80 | 126, len(text)) + text


@pytest.mark.parametrize(
    "value", [1, 1.5, True, "text", [1, 2], [1.0, 2], b"bytes", {"a": [True]}, -(2**63)]
)
def test_parameters_keep_their_type(front: Front, server: Server, value: object) -> None:
    """There and back: a float says that it is one, and bytes are base64."""
    given = ShownParameter("/node.a", value)
    assert ShownParameter.from_map(given.as_map()) == given


@pytest.mark.parametrize("value", [float("nan"), 2**63, [float("inf")], {1: 2}, object()])
def test_what_json_cannot_say_is_no_parameter(value: object) -> None:
    """A ValueError or TypeError, so that its text is shown instead."""
    with pytest.raises((TypeError, ValueError)):
        ShownParameter("/node.a", value)


@pytest.mark.parametrize(
    "message",
    [
        "{}",
        "[]",
        "7",
        "{",
        '{"op": 7}',
        '{"op": "subscribe"}',
        '{"op": "subscribe", "subscriptions": [{"id": true, "channelId": 1}]}',
        '{"op": "subscribe", "subscriptions": [{"id": -1, "channelId": 1}]}',
        '{"op": "fetchAsset", "uri": "package://a/b", "requestId": 4294967296}',
        '{"op": "getParameters", "parameterNames": [], "id": NaN}',
        '{"op": "setParameters", "parameters": [{"name": "a", "type": "float64", "value": "x"}]}',
        '{"op": "setParameters", "parameters": [{"name": "a", "value": 1e999}]}',
        '{"op": "fetchAsset", "uri": 7, "requestId": 1}',
        "[" * 100_000,
        b"",
        b"\x03\x00",
        b"\xff",
        b"\x01\x00\x00\x00\x00",
        b"\x02" + bytes(12),
    ],
)
def test_what_is_malformed_is_answered(front: Front, message: str | bytes) -> None:
    """With why, and the connection goes on."""
    with Client(front.port) as client:
        client.send_raw(message)
        eventually(client.said)
        client.send("getParameters", parameterNames=["/node.a"], id="1")
        eventually(lambda: client.parameters)


def test_a_call_that_fails_unforeseen_is_answered(server: Server, front: Front) -> None:
    """With what was raised: a client would wait for its answer for ever."""

    def call(request: bytes) -> bytes:
        raise KeyError("x")

    server.add_service(ServedService("/fails", "Fails", ("", "{}"), ("", "{}"), call))
    with Client(front.port) as client:
        assert "KeyError" in client.call("/fails", {})
