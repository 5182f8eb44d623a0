"""Streams as values: their state by tokens and descriptions, their counts, and reports of both."""

from tfbus.base.structs import Struct, fields_of, replace
from tfbus.wire.descriptions import FLOAT64, StreamDescription
from tfbus.wire.keys import namespace_of

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


# The weight of one message in the mean delay.
_SMOOTHING = 0.1

# The names of a stream's counts.
_COUNTED = tuple(
    each.name
    for each in fields_of(StreamInfo)[9:]
    if each.name not in ("clock_offset_s", "origin", "namespace", "silent", "poses")
)


class StreamCounts:
    """The counts of one stream, under the names that they have in `StreamInfo`, which explains
    them.

    Not safe by itself: hold the stream's lock to change it. Any thread may read it.
    """

    # A `Struct`, or attributes in a dict, would take longer to count.
    __slots__ = _COUNTED

    def __init__(self) -> None:
        self.messages = self.transforms = self.bytes = self.missed = 0
        self.outdated = self.disputed = self.rejected = self.excluded = self.forbidden = 0
        self.unnamed = 0
        self.unreadable = ""
        self.last_heard_ns: int | None = None
        self.delay_s: float | None = None
        self.last_delay_s: float | None = None
        self.kept_delay_s: float | None = None

    def add(self, transforms: int, size: int, heard_ns: int, delay_s: float | None = None) -> None:
        """Count one message of `transforms` rows and `size` bytes, which came at `heard_ns`; with
        its delay if it has one that is known.
        """
        self.messages += 1
        self.transforms += transforms
        self.bytes += size
        self.last_heard_ns = heard_ns
        if delay_s is not None:
            former_s = self.delay_s
            self.last_delay_s = delay_s
            self.delay_s = (
                delay_s if former_s is None else former_s + _SMOOTHING * (delay_s - former_s)
            )

    def add_kept(self, transforms: int, size: int, delay_s: float | None) -> None:
        """Count a message that the stream had kept, and how old it was when it came if that is
        known.
        """
        self.messages += 1
        self.transforms += transforms
        self.bytes += size
        former_s = self.kept_delay_s
        if delay_s is not None:
            self.kept_delay_s = delay_s if former_s is None else min(former_s, delay_s)

    def added_to(self, info: StreamInfo) -> StreamInfo:
        """The report with all of them."""
        counts = {name: getattr(self, name) for name in _COUNTED}
        counts["unreadable"] = self.unreadable or info.unreadable
        return replace(info, **counts)

    def forget_delays(self) -> None:
        """Forget the delays: a new epoch may be by another clock."""
        self.delay_s = self.last_delay_s = self.kept_delay_s = None


def described_stream(name: str, state: StreamState | None) -> StreamInfo:
    """The report of a stream without counts, from its token and its description."""
    info = StreamInfo(name)
    if state is None:
        return info
    info = replace(info, alive=state.alive, silent=state.silent, namespace=namespace_of(state.key))
    if (description := state.description) is None:
        return replace(info, unreadable=state.unreadable)
    return replace(
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
