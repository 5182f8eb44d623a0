"""Descriptions of nodes and streams on the bus; docs/reference/wire.md has the format."""

from typing import Any

from tfbus.base.errors import InvalidArgumentException
from tfbus.base.structs import Struct, field, replace
from tfbus.base.wording import (
    MOST_LETTERS,
    counted,
    duration,
    is_printable,
    listed,
    mistake_in,
    printable,
    wall,
)
from tfbus.geometry.packed import POSE_SIZE
from tfbus.wire.codec import as_map, decode_message, encode_map

# How a stream can send its poses; the first is the default, as version 1 has them.
FLOAT64, FLOAT32, COMPACT = POSES = ("float64", "float32", "compact")


def check_poses(poses: str) -> str:
    """The name, if it is one of `POSES`. Raises InvalidArgumentException for any other."""
    if poses not in POSES:
        raise InvalidArgumentException(f"poses {poses!r} is not one of {', '.join(POSES)}")
    return poses


class ParameterDescription(Struct):
    """A parameter: its name, value, type and, for numbers, bounds.

    Its texts but the value come as they can be printed.
    """

    name: str
    value: Any
    type: str
    description: str = ""
    minimum: Any = None
    maximum: Any = None

    def __post_init__(self) -> None:
        _make_printable(self, "name", "type")
        object.__setattr__(self, "description", printable(self.description, _LONGEST_TEXT))


class BufferDescription(Struct):
    """A node's buffer: how long it keeps samples.

    `too_old` lookups asked for a time before that, by at most `missed_by_s`. Its listener dropped
    `dropped` messages, as transforms came on too many keys. Of `mistaken` lookups the stamp was in
    another unit or of another clock, as the sentence `mistake` says of the last.
    """

    cache_time_s: float
    too_old: int = 0
    missed_by_s: float = 0.0
    dropped: int = 0
    mistaken: int = 0
    mistake: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "mistake", printable(self.mistake, _LONGEST_TEXT))


class DelayDescription(Struct):
    """A callback of a node that held up another: `what`, a timer or a topic of the node, left out
    `lost` ticks or messages, as the callback of `by` took up to `took_s`.
    """

    what: str
    lost: int
    by: str
    took_s: float

    def __post_init__(self) -> None:
        _make_printable(self, "what", "by")

    def __str__(self) -> str:
        """The losses of a node, as a sentence without its end."""
        lost = counted(self.lost, "tick" if self.what.startswith("timer") else "message")
        callback = "its own callback" if self.by == self.what else f"the callback of {self.by}"
        return f"{self.what} lost {lost}: {callback} took up to {duration(self.took_s)}"


class FailureDescription(Struct):
    """A callback of a node that raised `count` exceptions, the last, `error`, at `last_ns` by its
    system's clock, in ns since the Unix epoch.
    """

    what: str
    count: int
    error: str
    last_ns: int

    def __post_init__(self) -> None:
        _make_printable(self, "what")
        object.__setattr__(self, "error", printable(self.error, _LONGEST_TEXT))

    def __str__(self) -> str:
        """The count, as a sentence without its end."""
        times, last = counted(self.count, "time"), wall(self.last_ns)
        return f"the callback of {self.what} failed {times}, at last at {last}: {self.error}"


class FilterDescription(Struct):
    """A subscription of a node whose messages wait for their transform into a frame.

    `waiting` messages of the `topic` wait now, `passed` came with their transform, and `drops` did
    not, by reason; `last` says why the last one was dropped, and `last_ns` when, by its system's
    clock in ns since the Unix epoch, 0 if unknown. `sources` are frames of these.
    """

    topic: str
    frame: str
    waiting: int = 0
    passed: int = 0
    drops: dict[str, int] = field(default_factory=dict)
    last: str = ""
    sources: tuple[str, ...] = ()
    last_ns: int = 0

    def __post_init__(self) -> None:
        _make_printable(self, "topic", "frame", "sources")
        drops = {_printable(reason): count for reason, count in self.drops.items()}
        object.__setattr__(self, "drops", drops)
        object.__setattr__(self, "last", printable(self.last, _LONGEST_TEXT))

    @property
    def dropped(self) -> int:
        """How many messages were dropped."""
        return sum(self.drops.values())

    def __str__(self) -> str:
        """The counts, as a sentence without its end."""
        reasons = listed([f"{count} {reason}" for reason, count in self.drops.items()])
        dropped = f", {self.dropped} dropped ({reasons})" if self.drops else ""
        when = f" at {wall(self.last_ns)}" if self.last_ns else ""
        last = f"; the last{when}: {self.last}" if self.last else ""
        counts = f"{self.passed} passed, {self.waiting} waiting{dropped}"
        return f"topic {self.topic} into {self.frame!r}: {counts}{last}"


class NodeDescription(Struct):
    """A node: its name, host, start (ns since the Unix epoch), and interfaces.

    `publishes`, `subscribes`, `serves` and `calls` map names to the names of their types.
    `unread` are the `streams` with dynamic transforms that no process subscribes to, and
    `retained` the topics of `publishes` whose last message reaches late subscribers.
    `delays` are its callbacks that held up others, `failures` its callbacks that raised
    exceptions, and `filters` its subscriptions whose messages wait for transforms. All names come
    as they can be printed. On a closed bus `identity` is the node's, and `rights` a digest of the
    rights that it enforces.
    """

    name: str
    host: str
    pid: int
    version: str
    session: str
    started_ns: int
    streams: tuple[str, ...]
    parameters: tuple[ParameterDescription, ...]
    publishes: dict[str, str]
    subscribes: dict[str, str]
    serves: dict[str, str]
    calls: dict[str, str]
    unread: tuple[str, ...] = ()
    buffers: tuple[BufferDescription, ...] = ()
    retained: tuple[str, ...] = ()
    identity: str = ""
    rights: str = ""
    delays: tuple[DelayDescription, ...] = ()
    filters: tuple[FilterDescription, ...] = ()
    failures: tuple[FailureDescription, ...] = ()

    def __post_init__(self) -> None:
        _make_printable(self, "name", "host", "version", "session", "streams", "unread", "retained")
        _make_printable(self, "identity", "rights")
        _make_printable(self, "publishes", "subscribes", "serves", "calls")


class NodeDefinitions(Struct):
    """The part of a node's description that it has if that is asked for: the definitions of the ROS
    types that it publishes, by the names of the types, as texts of `.msg` files with all in them.
    `publishes` is the description's.
    """

    definitions: dict[str, str] = field(default_factory=dict)
    publishes: dict[str, str] = field(default_factory=dict)


# A parameter's description may be a sentence or two.
_LONGEST_TEXT = 1000


def _make_printable(description: object, *fields: str) -> None:
    """Escape characters that a screen must not get in these fields: texts, or tuples or maps."""
    for name in fields:
        object.__setattr__(description, name, _printable(getattr(description, name)))


def _printable(value: Any) -> Any:
    if isinstance(value, dict):
        return {_printable(name): _printable(each) for name, each in value.items()}
    if isinstance(value, tuple):
        return tuple(map(_printable, value))
    return printable(value, MOST_LETTERS)


# The fields that others than the node itself fill, in their order on the wire; always sent.
FILLED_BY_OTHERS = ("streams", "unread", "buffers")


STREAM_VERSION = 1


class StreamDescription(Struct):
    """A stream: the node that publishes it (full name), since when, and its frames.

    `v` is the version of this map. Its messages have the `epoch`, in ns. `frames` are rows of
    parent, child and whether the transform is static. `host`, `pid` and `session` (of Zenoh) are
    the node's. With `split` each frame has a key of its own. The stream keeps dynamic messages of
    the last `history_s` seconds. `started_ns` is when the node started, its first epoch; 0 if
    unknown. `origin` are the gids of the ROS publishers whose transforms a bridge sends in it.

    `poses` is how precise its dynamic transforms are, "float64", "float32" or "compact". In
    messages of the latter two frames have numbers: each of `numbered` is one, with the parent and
    child that it stands for in this epoch, and `origins` has the poses from which theirs count,
    seven floats of 64 bits each. `next_number` is the first that has not been given.
    """

    v: int
    node: str
    epoch: int
    frames: tuple[tuple[str, str, bool], ...]
    host: str = ""
    pid: int = 0
    session: str = ""
    priority: int = 0
    split: bool = False
    history_s: float = 0.0
    started_ns: int = 0
    origin: tuple[str, ...] = ()
    poses: str = FLOAT64
    next_number: int = 0
    numbered: tuple[tuple[int, str, str], ...] = ()
    origins: bytes = b""

    def __post_init__(self) -> None:
        if self.v != STREAM_VERSION:
            raise ValueError(
                f"a description of version {self.v}; this tfbus reads version {STREAM_VERSION}: "
                "update the older of the two"
            )
        _check_names(node=self.node, host=self.host, session=self.session, poses=self.poses)
        if len(self.origins) != POSE_SIZE * len(self.numbered):
            raise ValueError("field 'origins' must have a pose for each of 'numbered'")


# The fields of which a stream that names its frames in each message says nothing.
_OF_NUMBERED = ("poses", "next_number", "numbered", "origins")


def encode_stream(description: StreamDescription) -> bytes:
    """The payload of the description of a stream."""
    # Its fields go on the wire as they are; with 10,000 frames `as_map` would take 20 ms.
    return encode_map(_without_defaults(vars(description)))


def facts_of_stream(description: StreamDescription) -> dict[str, Any]:
    """The fields of a description as a recording has them, which names the frames of transforms
    itself.
    """
    facts = as_map(replace(description, next_number=0, numbered=(), origins=b""))
    return _without_defaults(facts)


def _without_defaults(fields: dict[str, Any]) -> dict[str, Any]:
    """Without the fields about numbers that are as they are without one."""
    kept = dict(fields)
    for name in _OF_NUMBERED:
        if not kept[name] or kept[name] == FLOAT64:
            del kept[name]
    return kept


class FramesAsked(Struct):
    """A question for the descriptions of streams that list one of these child frames, as the
    streams call them.
    """

    children: tuple[str, ...]


def read_description(payload: bytes) -> tuple[StreamDescription, str]:
    """The description of a stream in a payload, and the mistake in the name of the first frame that
    it leaves out, since no frame can have that name; "" if all are there.

    Raises DecodeError if it cannot be read, or the name of its node, host or session cannot be
    shown.
    """
    description = decode_message(StreamDescription, payload)
    mistake = ""
    frames = []
    for row in description.frames:
        wrong = mistake_in(row[0]) or mistake_in(row[1])
        mistake = mistake or wrong
        if not wrong:
            frames.append(row)
    return (replace(description, frames=tuple(frames)) if mistake else description), mistake


def _check_names(**names: str) -> None:
    for what, name in names.items():
        if not is_printable(name):
            raise ValueError(
                f"field '{what}' is '{printable(name, most=60)}': at most 255 letters that can be "
                "printed are allowed"
            )
