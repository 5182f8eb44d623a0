"""Types of messages in ROS 1: their definitions, and bytes from and to CDR."""

import threading
from functools import cache
from typing import Any, Protocol

from tfbus.errors import DecodeError, TfbusError
from tfbus.ros.definitions import TF_MESSAGE, Definition
from tfbus.ros.ros1 import decode_ros1_tf_message, encode_ros1_tf_message
from tfbus.ros.tf_message import TFMessageReader, TFMessageWriter
from tfbus.runtime.installation import install_command


class Ros1Type(Protocol):
    """A type as ROS 1 has it: `name` is "tf2_msgs/TFMessage", `text` its definition with all in
    it, and `md5` what publishers and subscribers agree by. Not thread-safe.
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
    """The text and the MD5 of a type in ROS 1, and what knows its fields in ROS 2."""
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
        except Exception as error:  # rosbags raises what its parts do
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
