"""ROS 1: its master, its types of messages, and transforms as its nodes send them."""

import struct
import sys
import threading
from array import array
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from http.client import HTTPConnection
from typing import Any, Protocol
from urllib.parse import urlsplit
from xmlrpc.client import ServerProxy, Transport

from tfbus.base.errors import DecodeError, InvalidArgumentException, TfbusError
from tfbus.base.installation import install_command
from tfbus.base.wording import printable, stamp_text
from tfbus.geometry.columns import Columns
from tfbus.geometry.packed import POSE_SIZE, edge_bytes, stamp_bytes
from tfbus.ros.definitions import TF_MESSAGE, Definition
from tfbus.ros.tf_message import TFMessageReader, TFMessageWriter

DEFAULT_MASTER = "http://localhost:11311"

# The answer of ROS 1's XML-RPC to a call that worked.
_DONE = 1


@dataclass(frozen=True)
class Ros1State:
    """The full names of the nodes that publish each topic, subscribe to it, and offer services."""

    publishers: Mapping[str, Sequence[str]]
    subscribers: Mapping[str, Sequence[str]]
    services: Mapping[str, Sequence[str]]

    @property
    def nodes(self) -> set[str]:
        """The full names of all these nodes."""
        kinds = (self.publishers, self.subscribers, self.services)
        return {node for kind in kinds for nodes in kind.values() for node in nodes}


class Ros1Master:
    """A master, or a node, at a URI; `caller` is the full name of the node that asks, which waits
    at most `within_s` seconds. Raises OSError if the URI is none. Not thread-safe.
    """

    def __init__(self, uri: str, caller: str, within_s: float = 2.0) -> None:
        try:
            parts = urlsplit(uri)
            host = parts.hostname or ""
            is_one = parts.scheme == "http" and parts.port != 0 and _may_be_a_host(host)
        except ValueError:
            is_one = False
        if not is_one:
            raise OSError(f"{printable(uri, 100)!r} is no URI of ROS 1, such as {DEFAULT_MASTER}")
        self._proxy = ServerProxy(uri, transport=_Transport(within_s))
        self._caller = caller

    def call(self, method: str, *values: Any) -> Any:
        """Its answer. Raises OSError if it does not, or not as ROS does."""
        try:
            code, said, answer = getattr(self._proxy, method)(self._caller, *values)
        except OSError:
            raise
        except Exception as error:  # http, xmlrpc and expat raise any error of their parsers
            reason = f"{type(error).__name__} {printable(str(error), 100)}"
            raise OSError(f"it does not answer as ROS 1 does: {reason}") from error
        if code != _DONE:
            raise OSError(printable(str(said), 200))
        return answer

    def state(self) -> Ros1State:
        """The knowledge of a master. Raises OSError as `call` does."""
        answer = self.call("getSystemState")
        try:
            first, second, third = (
                {str(name): [str(node) for node in nodes] for name, nodes in kind}
                for kind in answer
            )
        except (TypeError, ValueError) as error:
            raise OSError(f"it does not answer as a master of ROS 1 does: {error}") from error
        return Ros1State(first, second, third)


def _may_be_a_host(name: str) -> bool:
    """Whether a master may have this host name. Raises UnicodeError, a ValueError, where Python
    looks up no address of it: a part is empty or too long.
    """
    return bool(name.encode("idna")) and " " not in name and name.isprintable()


class _Transport(Transport):
    """A master that hangs is as good as none."""

    def __init__(self, within_s: float) -> None:
        super().__init__()
        self._within_s = within_s

    def make_connection(self, host: Any) -> HTTPConnection:
        made = super().make_connection(host)
        made.timeout = self._within_s
        return made


_NS_PER_S = 1_000_000_000

_U32 = struct.Struct("<I")
# Of a header: sequence number, seconds and nanoseconds, and the length of frame_id.
_HEAD = struct.Struct("<4I")
_STAMP = struct.Struct("<3I")
# The size of a transform with empty names.
_LEAST_SIZE = _HEAD.size + _U32.size + POSE_SIZE


def decode_ros1_tf_message(data: bytes) -> Columns:
    """The transforms of a tf2_msgs/TFMessage, or tf/tfMessage, as ROS 1 serializes it.

    Raises DecodeError if the bytes are no such message.
    """
    if len(data) < _U32.size:
        raise DecodeError(f"{len(data)} bytes are no TFMessage of ROS 1: it begins with a count")
    (count,) = _U32.unpack_from(data)
    if count * _LEAST_SIZE > len(data) - _U32.size:
        raise DecodeError(f"{count} transforms, and only {len(data) - _U32.size} bytes follow")
    index_of: dict[str, int] = {}
    edges, stamps, poses = [], [], []
    at = _U32.size
    try:
        for _ in range(count):
            _, seconds, nanoseconds, size = _HEAD.unpack_from(data, at)
            parent, at = _text(data, at + _HEAD.size, size)
            (size,) = _U32.unpack_from(data, at)
            child, at = _text(data, at + _U32.size, size)
            edges.append(
                edge_bytes(
                    index_of.setdefault(parent, len(index_of)),
                    index_of.setdefault(child, len(index_of)),
                )
            )
            stamps.append(stamp_bytes(seconds * _NS_PER_S + nanoseconds))
            poses.append(data[at : at + POSE_SIZE])
            at += POSE_SIZE
    except struct.error as error:
        raise DecodeError("the message ends within a transform") from error
    if at != len(data):
        what = "ends within a transform" if at > len(data) else "has more bytes than its type"
        raise DecodeError(f"the message {what}")
    return Columns.of_bytes(
        tuple(index_of), b"".join(edges), b"".join(stamps), _in_machine_order(b"".join(poses))
    )


def _text(data: bytes, at: int, size: int) -> tuple[str, int]:
    """A text, and where it ends."""
    end = at + size
    if end > len(data):
        raise DecodeError("the message ends within a name")
    try:
        return data[at:end].decode(), end
    except UnicodeDecodeError as error:
        shown = printable(data[at:end].decode(errors="backslashreplace"), 60)
        raise DecodeError(f"the name '{shown}' is not UTF-8") from error


def _in_machine_order(poses: bytes) -> bytes:
    if sys.byteorder == "little":
        return poses
    numbers = array("d", poses)
    numbers.byteswap()
    return numbers.tobytes()


def encode_ros1_tf_message(rows: Columns) -> bytes:
    """The tf2_msgs/TFMessage with these transforms as ROS 1 serializes it; sequence numbers are 0.

    Raises InvalidArgumentException for a stamp that is not in the years 1970 to 2106, and for a
    name that is not valid Unicode.
    """
    names = [_name_bytes(frame) for frame in rows.frames]
    poses = _in_machine_order(rows.poses_bytes())
    parts = [_U32.pack(rows.count)]
    at = 0
    for (parent, child), stamp in zip(rows.pairs(), rows.stamps_as_ints(), strict=True):
        seconds, nanoseconds = divmod(stamp, _NS_PER_S)
        if not 0 <= seconds < 2**32:
            frame = printable(rows.frames[child], 60)
            raise InvalidArgumentException(
                f"the stamp {stamp_text(stamp)} of frame '{frame}' does not fit a message of ROS "
                "1: it must be from 1970 to 2106"
            )
        parts += (_STAMP.pack(0, seconds, nanoseconds), names[parent], names[child])
        parts.append(poses[at : at + POSE_SIZE])
        at += POSE_SIZE
    return b"".join(parts)


@lru_cache(maxsize=10_000)
def _name_bytes(frame: str) -> bytes:
    """A text with its length before it."""
    try:
        name = frame.encode()
    except UnicodeEncodeError as error:
        raise InvalidArgumentException(
            f"the frame '{printable(frame, 60)}' is not valid Unicode: ROS messages cannot have it"
        ) from error
    return _U32.pack(len(name)) + name


class Ros1Type(Protocol):
    """A type as ROS 1 has it: `name` is "tf2_msgs/TFMessage", `text` its definition with all in
    it, and `md5` the sum by which publishers and subscribers agree. Not thread-safe.
    """

    name: str
    text: str
    md5: str

    def of_cdr(self, payload: bytes) -> bytes:
        """The message in ROS 1's bytes; its sequence numbers are 0."""

    def to_cdr(self, payload: bytes) -> bytes:
        """The message in CDR."""


def ros1_type(definition: Definition) -> Ros1Type:
    """The type in ROS 1 of one in ROS 2.

    Raises TfbusError if rosbags, which knows the types of ROS 1, is not installed, or if ROS
    1 has other fields under this name.
    """
    with _lock:
        text, md5, store = _looked_up(definition)
    name = definition.name.replace("/msg/", "/")
    if definition == TF_MESSAGE:
        return _Transforms(name, text, md5)
    return _AnyType(name, text, md5, definition.name, store)


# Types are registered one after the other.
_lock = threading.Lock()


@cache
def _looked_up(definition: Definition) -> tuple[str, str, Any]:
    """The text and the MD5 of a type in ROS 1, and the store with its fields in ROS 2."""
    try:
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore
    except ImportError as error:
        raise TfbusError(
            f"rosbags is not installed ({error}): {install_command('ros1')}"
        ) from error
    found = get_types_from_msg(definition.text, definition.name)
    theirs = get_typestore(Stores.ROS1_NOETIC)
    theirs.register({name: fields for name, fields in found.items() if name not in theirs.types})
    for name in found:
        if name != "std_msgs/msg/Header" and theirs.fielddefs[name][1] != found[name][1]:
            raise TfbusError(f"{name} has other fields in ROS 1 than in ROS 2")
    ours = get_typestore(Stores.EMPTY)
    ours.register(found)
    return (*theirs.generate_msgdef(definition.name, ros_version=1), ours)


class _AnyType:
    def __init__(self, name: str, text: str, md5: str, full_name: str, store: Any) -> None:
        self.name = name
        self.text = text
        self.md5 = md5
        self._full_name = full_name
        self._store = store

    def of_cdr(self, payload: bytes) -> bytes:
        return bytes(self._store.cdr_to_ros1(payload, self._full_name))

    def to_cdr(self, payload: bytes) -> bytes:
        try:
            return bytes(self._store.ros1_to_cdr(payload, self._full_name))
        except Exception as error:  # rosbags raises any error of its parts
            raise DecodeError(f"it is no {self.name}: {error}") from error


class _Transforms:
    """In a fifth of the time that a type takes of which only the definition is known."""

    def __init__(self, name: str, text: str, md5: str) -> None:
        self.name = name
        self.text = text
        self.md5 = md5
        self._reader = TFMessageReader()
        self._writer = TFMessageWriter()

    def of_cdr(self, payload: bytes) -> bytes:
        return encode_ros1_tf_message(self._reader.read(payload))

    def to_cdr(self, payload: bytes) -> bytes:
        return self._writer.write(decode_ros1_tf_message(payload))
