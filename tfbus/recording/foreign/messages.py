"""A foreign file as values: its channels, and its messages as bytes."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple, Protocol


@dataclass(frozen=True)
class ForeignChannel:
    """Messages of one topic, type and, where the file says so, publisher.

    `type_name` is as ROS 2 has it, `tf2_msgs/msg/TFMessage`, or as Foxglove, and `encoding` that of
    the messages: "cdr", "ros1", "json", "protobuf" or another. `definition` is the type's in
    `definition_format`, "ros2msg" or "ros1msg" among others; "" if the file has none. A topic
    that is `retained` is transient local in ROS 2, and latched in ROS 1.
    """

    topic: str
    type_name: str
    encoding: str
    definition_format: str = ""
    definition: str = ""
    publisher: str = ""
    retained: bool = False


class ForeignMessage(NamedTuple):
    """A message, and when the recorder received it."""

    log_ns: int
    channel: ForeignChannel
    data: bytes


class ForeignFile(Protocol):
    """A file, or the files of one rosbag2 recording.

    `start_ns` and `end_ns` are the log times of the first and last message, both 0 without any.
    `note` is what a user should know of it, "" for nothing.
    """

    name: str
    note: str
    start_ns: int
    end_ns: int

    @property
    def damage(self) -> list[str]:
        """The unreadable parts so far, and was left out."""

    def messages(self) -> Iterator[ForeignMessage]:
        """All messages in order of log time. Raises DecodeError if the file is damaged."""

    def close(self) -> None:
        """Close the file."""


def ros_type_name(name: str) -> str:
    """The name of a type of ROS 1, `tf2_msgs/TFMessage`, as ROS 2 has it; others as they are."""
    package, slash, type_name = name.partition("/")
    if not slash or "/" in type_name:
        return name
    return f"{package}/msg/{type_name}"
