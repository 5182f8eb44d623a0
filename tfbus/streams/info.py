"""Streams as values: their state by tokens and descriptions, and the report with its counts."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tfbus.base.structs import Struct, replace
from tfbus.wire.descriptions import StreamDescription
from tfbus.wire.keys import namespace_of
from tfbus.wire.numbered import FLOAT64

if TYPE_CHECKING:
    from tfbus.streams.reception import StreamReception

# Streams come and go: at most this many gone streams are remembered.
MOST_GONE = 1000


class StreamState(Struct):
    """A stream as its token and its description show it now.

    `name` is as `stream_of` gives it: `sim`, or `robot7/sim` outside of the namespace. `alive`
    is whether its publisher is there. `description` is the last it has sent, None before the
    first. `key` is its token's and its description's. `confirmed` is whether the description
    came from the session that it names, since the token did. `displaced` is the session
    that was there before others took over with later epochs, "" for none; `held` is whether it has
    come back since, as it lives. `silent` is whether its token is lost, as with its link, and it
    is not gone yet. `unreadable` says of one without a description why it could not be read.
    """

    name: str
    alive: bool = False
    description: StreamDescription | None = None
    key: str = ""
    confirmed: bool = False
    displaced: str = ""
    held: bool = False
    silent: bool = False
    unreadable: str = ""

    @property
    def owner(self) -> str:
        """The session that is known to publish it; "" for none."""
        return self.description.session if self.confirmed and self.description else ""


class StreamInfo(Struct):
    """A stream: its publisher, whether it is there, and the counts of its messages.

    `node` (full name), `host`, `pid`, `session` and `priority` are from the description of the
    stream `name`, empty before it; `frames` are its rows of parent, child and whether it is static.
    `alive` is whether its publisher is there, and `silent` whether its link is lost, on a network
    on which it is not gone at once. `epoch_ns` is the epoch of its messages.

    `messages`, `transforms` and `bytes` were received. `missed` messages were sent and never came;
    `outdated` ones were of a former epoch; `disputed` ones of an epoch that the stream's publisher
    had not confirmed; `rejected` ones could not be read, the last for the reason
    `unreadable`; without any, its description could not. `excluded` transforms were dropped, since
    another publisher has priority for their frame; `forbidden` ones, since the stream may not have
    their frame on a closed bus. `last_heard_ns` is when the last message came,
    by the system's clock, in ns since the Unix epoch. `delay_s` is how old a transform is when it
    comes, by its stamp and our clock, smoothed over about ten messages. `clock_offset_s` is how far
    the publisher's clock is ahead of ours. `last_delay_s` is the delay of the last message, not
    smoothed; `kept_delay_s` is how old the newest was that the stream had kept, when that came. All
    five are None while they are not known. `origin` are the gids of the publishers in ROS whose
    transforms a bridge sends in it. `namespace` is its publisher's, below the listener's: the
    robot of a fleet. `poses` is how precise its dynamic transforms are, "float64", "float32" or
    "compact"; `unnamed` messages had frames whose numbers had not been described when they came:
    they are read again when they are.
    """

    name: str
    node: str = ""
    host: str = ""
    pid: int = 0
    session: str = ""
    alive: bool = False
    epoch_ns: int | None = None
    frames: tuple[tuple[str, str, bool], ...] = ()
    priority: int = 0
    messages: int = 0
    transforms: int = 0
    bytes: int = 0
    missed: int = 0
    outdated: int = 0
    disputed: int = 0
    rejected: int = 0
    excluded: int = 0
    forbidden: int = 0
    last_heard_ns: int | None = None
    delay_s: float | None = None
    clock_offset_s: float | None = None
    last_delay_s: float | None = None
    origin: tuple[str, ...] = ()
    kept_delay_s: float | None = None
    namespace: str = ""
    silent: bool = False
    poses: str = FLOAT64
    unnamed: int = 0
    unreadable: str = ""


def stream_info(name: str, state: StreamState | None, stream: StreamReception | None) -> StreamInfo:
    """The report of a stream, from its token, its description, and its counts."""
    info = StreamInfo(name)
    if state is not None:
        info = replace(
            info, alive=state.alive, silent=state.silent, namespace=namespace_of(state.key)
        )
    if state is not None and state.description is not None:
        description = state.description
        info = replace(
            info,
            node=description.node,
            host=description.host,
            pid=description.pid,
            session=description.session,
            epoch_ns=description.epoch,
            frames=description.frames,
            priority=description.priority,
            origin=description.origin,
            poses=description.poses,
        )
    if stream is not None:
        info = replace(
            info,
            epoch_ns=info.epoch_ns if stream.epoch_ns is None else stream.epoch_ns,
            **stream.counts.as_map(),
        )
    if state is not None and state.description is None and not info.unreadable:
        info = replace(info, unreadable=state.unreadable)
    return info
