"""Foxglove's server: channels that its clients subscribe to, their requests and messages.

All of it is Python's, on one thread and its workers. The foxglove-sdk holds locks of its own while
it calls Python, and takes the same locks in calls that hold Python's lock: a client that subscribed
to the graph at the moment in which it was published stopped the process for good. Here the lock of
the server is held for changes of its state alone: whoever holds it calls nothing that waits.
"""

import asyncio
import itertools
import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

from tfbus.base.callbacks import Given, Workers
from tfbus.base.errors import TfbusError
from tfbus.base.log import LogOnce
from tfbus.base.wording import printable
from tfbus.foxglove.client import Connection, Requests, ServedClient
from tfbus.foxglove.nodes import Connections, graph_update
from tfbus.foxglove.protocol import (
    SUBPROTOCOL,
    Capability,
    Level,
    PlaybackState,
    ShownParameter,
    answer,
    file_of,
    message_head,
    no_file,
    parameter_values,
    stamp_of,
    text,
    time_of,
)

# Clients are told at most this many errors a second, since any client can cause them.
_MOST_SAID = 20

# Files and parameters that are fetched at the same time, and requests that wait for it.
_AT_A_TIME = 8
_WAITING = 64

# Calls of services at the same time, each of which has a thread.
_CALLS_AT_A_TIME = 16

# In messages without a schema of their own.
_ENCODINGS = ("json", "cdr")


@dataclass(frozen=True, slots=True)
class ServedService:
    """A service: its name, and the schemas, in JSON, of its request and response.

    `call(request)` gets and returns JSON. It runs on a thread of its own, and raises TfbusError or
    ValueError if it fails.
    """

    name: str
    type: str
    request: tuple[str, str]
    response: tuple[str, str]
    call: Callable[[bytes], bytes]


class ServedChannel:
    """A topic with messages of one schema, which clients can subscribe to."""

    def __init__(self, server: "Server", number: int, topic: str, described: dict[str, object]):
        self.id = number
        self.topic = topic
        self.described = described
        self.subscribers: tuple[tuple[Connection, int], ...] = ()
        self._server = server

    @property
    def is_watched(self) -> bool:
        """Whether a client subscribes."""
        return bool(self.subscribers)

    def send(self, message: bytes, log_ns: int) -> None:
        """Send a message to all that subscribe."""
        for connection, subscription in self.subscribers:
            connection.send(message_head(subscription, log_ns) + message)

    def close(self) -> None:
        """Take the channel back. Twice is fine."""
        self._server.close_channel(self)


class Server:
    """The server of the clients of a `Front`, until `close()`; its methods return at once, on any
    thread.

    `time_range_ns`, the first and last time of a recording, brings Foxglove's playback bar.
    """

    def __init__(
        self,
        name: str,
        requests: Requests,
        capabilities: Collection[Capability],
        log: logging.Logger,
        *,
        time_range_ns: tuple[int, int] | None = None,
    ) -> None:
        self.capabilities = frozenset({*capabilities, Capability.ASSETS})
        self.requests = requests
        self._name = name
        self._time_range_ns = time_range_ns
        self._once = LogOnce(log)
        self._lock = threading.Lock()
        self._session = _new_session()
        self._ids = itertools.count(1)
        self._clients: set[ServedClient] = set()
        self._channels: dict[int, ServedChannel] = {}
        self._services: dict[int, ServedService] = {}
        self._graph = Connections()
        self._said_s: deque[float] = deque(maxlen=_MOST_SAID)
        self._jobs = Workers("foxglove requests", threads=_AT_A_TIME, waiting=_WAITING)
        self._calls = Workers("foxglove calls", threads=_CALLS_AT_A_TIME, waiting=0)

    def close(self) -> None:
        """Begin no further calls of services and no reading of files. The clients' end is their
        front's. Twice is fine.
        """
        self._jobs.close(0.0)
        self._calls.close(0.0)

    # One client, in the loop of its front

    async def serve(
        self, head: bytes, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
        """Serve a client that has sent the head of a request, until it ends."""
        connection = Connection(head, reader, writer, SUBPROTOCOL)
        if not connection.is_open:
            await writer.drain()
            return
        client = ServedClient(next(self._ids), connection, self)
        writing = asyncio.create_task(connection.write())
        self._welcome(client)
        try:
            async for message in connection.messages():
                client.take(message)
        finally:
            writing.cancel()
            with self._lock:
                self._clients.discard(client)
            client.leave()

    def _welcome(self, client: ServedClient) -> None:
        with self._lock:
            self._clients.add(client)
            client.tell(self._info())
            if self._channels:
                channels = [each.described for each in self._channels.values()]
                client.tell(text("advertise", channels=channels))
            if self._services:
                services = [_described(*each) for each in self._services.items()]
                client.tell(text("advertiseServices", services=services))

    def _info(self) -> str:
        capabilities = set(self.capabilities)
        if Capability.PARAMETERS in capabilities:
            capabilities.add(Capability.PARAMETERS_SUBSCRIBE)
        begin_ns, end_ns = self._time_range_ns or (None, None)
        return text(
            "serverInfo",
            name=self._name,
            capabilities=sorted(capabilities),
            supportedEncodings=_ENCODINGS,
            metadata={},
            sessionId=self._session,
            dataStartTime=None if begin_ns is None else stamp_of(begin_ns),
            dataEndTime=None if end_ns is None else stamp_of(end_ns),
        )

    def guarded(self, what: Callable[[*Given], None], *given: *Given) -> None:
        """Follow a client's request; an exception, which is a defect, is logged, the first."""
        try:
            what(*given)
        except Exception:
            self._once.exception("request", "Could not answer a client of Foxglove's")

    # Channels

    def open_channel(
        self, topic: str, encoding: str, schema: tuple[str, str, bytes] | None = None
    ) -> ServedChannel:
        """A channel; the schema is its name, its encoding and its text."""
        number = next(self._ids)
        described: dict[str, object] = {"id": number, "topic": topic, "encoding": encoding}
        if schema is None:
            described |= {"schemaName": "", "schema": ""}
        else:
            name, of, data = schema
            described |= {"schemaName": name, "schemaEncoding": of, "schema": data.decode()}
        channel = ServedChannel(self, number, topic, described)
        with self._lock:
            self._channels[number] = channel
            self._tell_all(text("advertise", channels=[described]))
        return channel

    def close_channel(self, channel: ServedChannel) -> None:
        """Take a channel back. Twice is fine."""
        with self._lock:
            if self._channels.pop(channel.id, None) is None:
                return
            channel.subscribers = ()
            for client in self._clients:
                client.subscriptions = {
                    own: at for own, at in client.subscriptions.items() if at is not channel
                }
            self._tell_all(text("unadvertise", channelIds=[channel.id]))

    def subscribe(self, client: ServedClient, subscription: int, channel_id: int) -> str:
        """Let a client subscribe; returns why it cannot, "" if it does."""
        with self._lock:
            channel = self._channels.get(channel_id)
            if channel is None:
                return f"there is no channel {channel_id}"
            if subscription in client.subscriptions:
                return f"subscription {subscription} is in use"
            if channel in client.subscriptions.values():
                return f"channel {channel_id} has a subscription of this client already"
            client.subscriptions = {**client.subscriptions, subscription: channel}
            channel.subscribers = (*channel.subscribers, (client.connection, subscription))
        return ""

    def unsubscribe(self, client: ServedClient, subscriptions: Collection[int]) -> list[int]:
        """End subscriptions of a client; returns the channels of the ones that it had."""
        with self._lock:
            gone = [own for own in subscriptions if own in client.subscriptions]
            channels = [client.subscriptions[own] for own in gone]
            for channel in channels:
                channel.subscribers = tuple(
                    each for each in channel.subscribers if each[0] is not client.connection
                )
            client.subscriptions = {
                own: at for own, at in client.subscriptions.items() if own not in gone
            }
        return [channel.id for channel in channels]

    # To all clients

    def _tell_all(self, message: str | bytes, *, in_order: bool = False) -> None:
        for client in self._clients:
            client.tell(message, in_order=in_order)

    def say(self, reason: str) -> None:
        """Show an error in all clients; more than 20 in a second are left out."""
        now_s = time.monotonic()
        with self._lock:
            if len(self._said_s) == _MOST_SAID and now_s < self._said_s[0] + 1.0:
                return
            self._said_s.append(now_s)
            self._tell_all(text("status", level=Level.ERROR, message=printable(reason, 500)))

    def tell_time(self, now_ns: int) -> None:
        """Tell the time to all clients."""
        message = time_of(now_ns)
        with self._lock:
            for client in self._clients:
                client.connection.send(message)

    def tell_playback(self, state: PlaybackState) -> None:
        """Tell how the recording plays, after its messages so far."""
        with self._lock:
            self._tell_all(state.as_bytes(), in_order=True)

    def forget_the_past(self) -> None:
        """Make all clients drop their data: time went back."""
        with self._lock:
            self._session = _new_session()
            self._tell_all(self._info(), in_order=True)

    # Parameters, and the graph

    def publish_parameters(self, parameters: Sequence[ShownParameter]) -> None:
        """Send parameters to the clients that subscribe to them."""
        with self._lock:
            for client in self._clients:
                watched = [each for each in parameters if each.name in client.parameters]
                if watched:
                    client.tell(parameter_values(watched))

    def set_parameters(
        self, client: ServedClient, given: Sequence[ShownParameter], request_id: str | None
    ) -> None:
        """Set parameters; the client is told of them if it gave an id, and all that subscribe
        to them.
        """

        def set_them() -> None:
            done = self.requests.set_parameters(given)
            if request_id is not None:
                client.tell(parameter_values(done, request_id))
            self.publish_parameters(done)

        if not self._jobs.do(self.guarded, set_them):
            client.say("too many requests at once; retry later")

    def publish_graph(self, graph: Connections) -> None:
        """Send the changes of the graph of nodes to the clients that subscribe to it."""
        with self._lock:
            former, self._graph = self._graph, graph
            message = graph_update(former, graph)
            for client in self._clients:
                if client.has_graph:
                    client.tell(message)

    def subscribe_graph(self, client: ServedClient) -> None:
        """Send the graph to a client, and from now on its changes."""
        with self._lock:
            client.has_graph = True
            client.tell(graph_update(Connections(), self._graph))

    # Services and files

    def add_service(self, service: ServedService) -> None:
        """Offer a service."""
        number = next(self._ids)
        with self._lock:
            self._services[number] = service
            self._tell_all(text("advertiseServices", services=[_described(number, service)]))

    def remove_services(self, names: Collection[str]) -> None:
        """Take services back."""
        with self._lock:
            gone = [number for number, each in self._services.items() if each.name in names]
            for number in gone:
                del self._services[number]
            if gone:
                self._tell_all(text("unadvertiseServices", serviceIds=gone))

    def call(self, client: ServedClient, service_id: int, call_id: int, request: bytes) -> None:
        """Call a service for a client, on a thread."""

        def fail(reason: str) -> None:
            client.tell(
                text("serviceCallFailure", serviceId=service_id, callId=call_id, message=reason)
            )

        def run(service: ServedService) -> None:
            try:
                response = service.call(request)
            except (TfbusError, ValueError) as error:
                fail(str(error))
            except Exception as error:
                fail(f"the call failed ({type(error).__name__}: {error})")
                raise
            else:
                client.tell(answer(service_id, call_id, "json", response))

        with self._lock:
            service = self._services.get(service_id)
        if service is None:
            fail("there is no such service any more")
        elif not self._calls.do(self.guarded, run, service):
            fail(f"busy: {_CALLS_AT_A_TIME} calls are running")

    def fetch(self, client: ServedClient, request_id: int, uri: str) -> None:
        """Send a client a file, which a thread reads."""

        def read() -> None:
            try:
                client.tell(file_of(request_id, self.requests.asset(uri)))
            except (TfbusError, ValueError) as error:
                client.tell(no_file(request_id, str(error)))
            except Exception as error:
                client.tell(no_file(request_id, f"it failed ({type(error).__name__}: {error})"))
                raise

        if not self._jobs.do(self.guarded, read):
            client.tell(no_file(request_id, "too many requests at once; retry later"))


def _described(number: int, service: ServedService) -> dict[str, object]:
    return {
        "id": number,
        "name": service.name,
        "type": service.type,
        "request": _schema(*service.request),
        "response": _schema(*service.response),
    }


def _schema(name: str, schema: str) -> dict[str, str]:
    return {
        "encoding": "json",
        "schemaName": name,
        "schemaEncoding": "jsonschema",
        "schema": schema,
    }


def _new_session() -> str:
    return str(time.time_ns() // 1_000_000)
