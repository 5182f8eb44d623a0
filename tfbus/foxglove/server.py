"""Foxglove's server: channels that its clients subscribe to, and what they ask and send."""

import logging
import threading
import time
from collections import deque
from collections.abc import Sequence
from typing import Any

import foxglove
from foxglove import ConnectionGraph, Parameter, Schema, Service
from foxglove.websocket import (
    Capability,
    ChannelView,
    Client,
    ClientChannel,
    PlaybackControlRequest,
    PlaybackState,
    ServerListener,
    StatusLevel,
)

from tfbus.errors import TfbusError
from tfbus.wording import printable

# A client that reads too slowly loses the oldest messages beyond this number.
_BACKLOG = 1024

# A client whose queue of errors is full is disconnected by the SDK, and any client can cause them.
_MOST_SAID = 20

# The SDK logs each message of a client that it cannot read, which the client learns as well: any
# client could fill our log.
logging.getLogger("foxglove").setLevel(logging.CRITICAL)


class Requests:
    """What clients ask and send; a bridge overrides what it answers.

    All come on threads of the SDK, which serve no client for that time: return soon.
    """

    def subscribed(self, channel_id: int) -> None:
        """A client subscribes to a channel."""

    def unsubscribed(self, channel_id: int) -> None:
        """A client no longer subscribes, or is gone."""

    def get_parameters(self, names: Sequence[str]) -> list[Parameter]:
        """These parameters; all where no name is given."""
        return []

    def set_parameters(self, given: Sequence[Parameter]) -> list[Parameter]:
        """Set parameters; returns those that are known to be set by now."""
        return []

    def parameters_subscribed(self, names: Sequence[str]) -> None:
        """Clients subscribe to parameters to which none did before."""

    def advertised(self, client_id: int, channel: ClientChannel) -> None:
        """A client is going to publish."""

    def unadvertised(self, client_id: int, channel_id: int) -> None:
        """A client no longer publishes, or is gone."""

    def published(self, client_id: int, channel_id: int, data: bytes) -> None:
        """A client publishes."""

    def control(self, request: PlaybackControlRequest) -> PlaybackState | None:
        """A client plays, pauses, seeks, or changes the speed."""
        return None

    def asset(self, uri: str) -> bytes:
        """A client asks for a file. Raises TfbusError where it cannot have it."""
        raise TfbusError("there are no files")


class Channel:
    """What clients can subscribe to: a topic with messages of one schema."""

    def __init__(self, base: Any) -> None:
        self._base = base
        self.id: int = base.id()
        self.topic: str = base.topic()

    @property
    def is_watched(self) -> bool:
        """Whether a client subscribes."""
        return bool(self._base.has_sinks())

    def send(self, message: bytes, log_ns: int) -> None:
        """Send a message to all that subscribe."""
        self._base.log(message, log_ns)

    def close(self) -> None:
        """Take the channel back. Twice is fine."""
        self._base.close()


class Server:
    """A server at an address, until `close()`; port 0 is one that the system chooses.

    `time_range_ns`, the first and last time of a recording, brings Foxglove's playback bar.
    Raises TfbusError where it cannot listen.
    """

    def __init__(
        self,
        name: str,
        host: str,
        port: int,
        requests: Requests,
        capabilities: Sequence[Capability],
        *,
        time_range_ns: tuple[int, int] | None = None,
    ) -> None:
        self._context = foxglove.Context()
        self._host = host
        self._lock = threading.Lock()
        self._said_s: deque[float] = deque(maxlen=_MOST_SAID)
        try:
            self._server = foxglove.start_server(
                name=name,
                host=host,
                port=port,
                context=self._context,
                capabilities=list(capabilities),
                server_listener=_Listener(requests),
                asset_handler=requests.asset,
                supported_encodings=["json", "cdr"],
                playback_time_range=time_range_ns,
                message_backlog_size=_BACKLOG,
            )
        except RuntimeError as error:
            reason = str(error).rpartition("bind port: ")[2]
            raise TfbusError(f"could not listen at {host}:{port}: {reason}") from error

    @property
    def address(self) -> tuple[str, int]:
        """The host and port that it listens on."""
        return self._host, self._server.port

    def close(self) -> None:
        """Stop; all clients are disconnected."""
        self._server.stop()

    def open_channel(
        self, topic: str, encoding: str, schema: tuple[str, str, bytes] | None = None
    ) -> Channel:
        """A channel; the schema is its name, its encoding and its text."""
        given = None
        if schema is not None:
            name, of, data = schema
            given = Schema(name=name, encoding=of, data=data)
        return Channel(
            self._context._create_channel(topic, message_encoding=encoding, schema=given)
        )

    # What all clients get

    def say(self, text: str) -> None:
        """Show an error in all clients; more than 20 in a second are left out."""
        now_s = time.monotonic()
        with self._lock:
            if len(self._said_s) == _MOST_SAID and now_s < self._said_s[0] + 1.0:
                return
            self._said_s.append(now_s)
        self._server.publish_status(printable(text, 500), StatusLevel.Error)

    def tell_time(self, now_ns: int) -> None:
        """Tell the time to all clients."""
        self._server.broadcast_time(now_ns)

    def tell_playback(self, state: PlaybackState) -> None:
        """Tell how the recording plays."""
        self._server.broadcast_playback_state(state)

    def forget_the_past(self) -> None:
        """Make all clients drop what they have: time went back."""
        self._server.clear_session()

    def publish_parameters(self, parameters: Sequence[Parameter]) -> None:
        """Send parameters to the clients that subscribe to them."""
        self._server.publish_parameter_values(list(parameters))

    def publish_graph(self, graph: ConnectionGraph) -> None:
        """Send the graph of nodes to the clients that subscribe to it."""
        self._server.publish_connection_graph(graph)

    def add_service(self, service: Service) -> None:
        """Offer a service."""
        self._server.add_services([service])

    def remove_services(self, names: Sequence[str]) -> None:
        """Take services back."""
        self._server.remove_services(list(names))


class _Listener(ServerListener):
    """Passes on what the SDK calls."""

    def __init__(self, requests: Requests) -> None:
        self._requests = requests

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:
        self._requests.subscribed(channel.id)

    def on_unsubscribe(self, client: Client, channel: ChannelView) -> None:
        self._requests.unsubscribed(channel.id)

    def on_client_advertise(self, client: Client, channel: ClientChannel) -> None:
        self._requests.advertised(client.id, channel)

    def on_client_unadvertise(self, client: Client, client_channel_id: int) -> None:
        self._requests.unadvertised(client.id, client_channel_id)

    def on_message_data(self, client: Client, client_channel_id: int, data: bytes) -> None:
        self._requests.published(client.id, client_channel_id, data)

    def on_get_parameters(
        self, client: Client, param_names: list[str], request_id: str | None = None
    ) -> list[Parameter]:
        return self._requests.get_parameters(param_names)

    def on_set_parameters(
        self, client: Client, parameters: list[Parameter], request_id: str | None = None
    ) -> list[Parameter]:
        return self._requests.set_parameters(parameters)

    def on_parameters_subscribe(self, param_names: list[str]) -> None:
        self._requests.parameters_subscribed(param_names)

    def on_playback_control_request(
        self, playback_control_request: PlaybackControlRequest
    ) -> PlaybackState | None:
        return self._requests.control(playback_control_request)
