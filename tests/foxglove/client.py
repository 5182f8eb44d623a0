"""A client of Foxglove's protocol, foxglove.sdk.v1, as its specification has it."""

import asyncio
import json
import struct
import threading
from collections.abc import Coroutine
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, TypeVar

from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed

from tests.buses import DEADLINE_S, eventually
from tfbus import TransformStamped
from tfbus.ros.tf_message import TFMessageReader

T = TypeVar("T")


@dataclass(frozen=True)
class Playback:
    """How the server says that a recording plays: 0 playing, 1 paused, 2 buffering, 3 ended."""

    status: int
    time_ns: int
    speed: float
    did_seek: bool
    request_id: str


class Client:
    """Keeps all that comes; use it in a `with`.

    Its socket belongs to one thread: websockets.sync reads and writes on two, and the TLS of Python
    3.11 then loses what comes while it writes.
    """

    def __init__(self, port: int, *, query: str = "", **options: Any) -> None:
        self.port = port
        scheme = "wss" if "ssl" in options else "ws"
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, daemon=True)
        self._thread.start()
        self.channels: dict[str, dict[str, Any]] = {}
        self.services: dict[str, dict[str, Any]] = {}
        self.parameters: dict[str, Any] = {}
        self.published: dict[str, list[str]] = {}
        self.subscribed: dict[str, list[str]] = {}
        self.texts: list[dict[str, Any]] = []
        self.messages: list[tuple[str, int, bytes]] = []
        self.times_ns: list[int] = []
        self.playback: list[Playback] = []
        self.answers: dict[int, Any] = {}
        self.assets: dict[int, bytes | str] = {}
        self._asked = 0
        self._topics: dict[int, str] = {}
        try:
            self._socket = self._wait_for(
                _connected(
                    f"{scheme}://127.0.0.1:{port}{query}",
                    subprotocols=["foxglove.sdk.v1"],
                    open_timeout=DEADLINE_S,
                    max_size=None,
                    **options,
                )
            )
        except BaseException:
            self._end()
            raise
        self._reading = asyncio.run_coroutine_threadsafe(self._read(), self._loop)

    def __enter__(self) -> "Client":
        return self

    def __exit__(self, *_: object) -> None:
        self._wait_for(self._socket.close())
        self._reading.result(DEADLINE_S)
        self._end()

    def _end(self) -> None:
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(DEADLINE_S)
        self._loop.close()

    def _wait_for(self, what: Coroutine[Any, Any, T]) -> T:
        return asyncio.run_coroutine_threadsafe(what, self._loop).result(DEADLINE_S)

    # What it sends

    def send(self, op: str, **fields: Any) -> None:
        """One message in JSON."""
        self.send_raw(json.dumps({"op": op, **fields}))

    def send_raw(self, message: str | bytes) -> None:
        """Anything."""
        self._wait_for(self._socket.send(message))

    def subscribe(self, topic: str) -> dict[str, Any]:
        """Subscribe to a topic once it is there; returns its channel."""
        channel = eventually(lambda: self.channels.get(topic))
        self._topics[channel["id"]] = topic
        subscription = {"id": channel["id"], "channelId": channel["id"]}
        self.send("subscribe", subscriptions=[subscription])
        return channel

    def unsubscribe(self, topic: str) -> None:
        """No longer subscribe."""
        self.send("unsubscribe", subscriptionIds=[self.channels[topic]["id"]])

    def advertise(self, topic: str, schema: str, encoding: str = "json") -> None:
        """Be going to publish, on channel 1."""
        self.send(
            "advertise",
            channels=[{"id": 1, "topic": topic, "encoding": encoding, "schemaName": schema}],
        )

    def publish(self, data: bytes) -> None:
        """Publish on channel 1."""
        self.send_raw(b"\x01" + struct.pack("<I", 1) + data)

    def call(self, service: str, request: Any) -> Any:
        """Call a service; its response, or the text of its refusal."""
        found = eventually(lambda: self.services.get(service))
        call_id = len(self.answers) + 1
        head = struct.pack("<BIII", 2, found["id"], call_id, 4)
        self.send_raw(head + b"json" + json.dumps(request).encode())
        return eventually(lambda: self.answers.get(call_id))

    def fetch(self, uri: str) -> bytes | str:
        """Ask for a file; its content, or the text of the refusal."""
        self._asked = number = self._asked + 1
        self.send("fetchAsset", uri=uri, requestId=number)
        eventually(lambda: number in self.assets)
        return self.assets[number]

    def control(
        self, *, play: bool, speed: float = 1.0, seek_ns: int | None = None, request: str = "r"
    ) -> Playback:
        """Use the playback bar; returns the answer."""
        name = request.encode()
        head = struct.pack("<BBfB", 3, 0 if play else 1, speed, seek_ns is not None)
        self.send_raw(head + struct.pack("<QI", seek_ns or 0, len(name)) + name)
        return eventually(
            lambda: next((each for each in self.playback if each.request_id == request), None)
        )

    # What came

    def of(self, topic: str) -> list[bytes]:
        """The messages of a topic."""
        return [data for name, _, data in list(self.messages) if name == topic]

    def transforms_at(self, topic: str, log_ns: int) -> list[TransformStamped]:
        """The transforms that came on a topic with this log time."""
        found = [
            data for name, at_ns, data in list(self.messages) if (name, at_ns) == (topic, log_ns)
        ]
        return [each for data in found for each in TFMessageReader().read(data)]

    def texts_of(self, op: str) -> list[dict[str, Any]]:
        """The messages in JSON of one kind."""
        return [each for each in list(self.texts) if each["op"] == op]

    def said(self) -> list[str]:
        """The errors that the server showed."""
        return [each["message"] for each in self.texts_of("status")]

    async def _read(self) -> None:
        with suppress(ConnectionClosed):
            async for message in self._socket:
                if isinstance(message, str):
                    self._take_text(json.loads(message))
                else:
                    self._take_bytes(message)

    def _take_text(self, text: dict[str, Any]) -> None:
        self.texts.append(text)
        match text["op"]:
            case "advertise":
                self.channels |= {each["topic"]: each for each in text["channels"]}
            case "unadvertise":
                gone = set(text["channelIds"])
                for topic in [t for t, each in self.channels.items() if each["id"] in gone]:
                    del self.channels[topic]
            case "advertiseServices":
                self.services |= {each["name"]: each for each in text["services"]}
            case "parameterValues":
                self.parameters |= {each["name"]: each.get("value") for each in text["parameters"]}
            case "connectionGraphUpdate":
                for each in text["publishedTopics"]:
                    self.published[each["name"]] = each["publisherIds"]
                for each in text["subscribedTopics"]:
                    self.subscribed[each["name"]] = each["subscriberIds"]
            case "serviceCallFailure":
                self.answers[text["callId"]] = text["message"]

    def _take_bytes(self, data: bytes) -> None:
        match data[0]:
            case 1:
                channel, log_ns = struct.unpack_from("<IQ", data, 1)
                self.messages.append((self._topics[channel], log_ns, data[13:]))
            case 2:
                self.times_ns.append(struct.unpack_from("<Q", data, 1)[0])
            case 3:
                _, call_id, length = struct.unpack_from("<III", data, 1)
                self.answers[call_id] = json.loads(data[13 + length :])
            case 4:
                number, status, length = struct.unpack_from("<IBI", data, 1)
                text, content = data[10 : 10 + length].decode(), data[10 + length :]
                self.assets[number] = text if status else content
            case 5:
                status, time_ns, speed, did_seek, length = struct.unpack_from("<BQfBI", data, 1)
                name = data[19 : 19 + length].decode()
                self.playback.append(Playback(status, time_ns, speed, bool(did_seek), name))


async def _connected(url: str, **options: Any) -> ClientConnection:
    return await connect(url, **options)
