"""Files of rosbag1 and rosbag2, read by the library rosbags."""

import sqlite3
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

from tfbus.errors import DecodeError
from tfbus.recording.foreign.messages import ForeignChannel, ForeignMessage, ros_type_name
from tfbus.recording.records import MOST_CHUNK_BYTES, of_bz2, of_lz4, of_zstd
from tfbus.wording import printable

# How a database of SQLite begins.
_SQLITE = b"SQLite format 3\0"

# As rosbags names the formats of definitions.
_DEFINITION_FORMATS = {1: "msg", 2: "idl"}


class RosbagsFile:
    """A .bag, a .db3, or the folder of a rosbag2 recording with its metadata.yaml.

    Raises DecodeError if it cannot be read, OSError, and ImportError without rosbags.
    """

    def __init__(self, path: Path) -> None:
        self.name = printable(str(path))
        self.note = ""
        self._path = path
        # A recording of rosbag2 is a folder, whatever its name is.
        self._is_ros1 = path.suffix == ".bag" and not path.is_dir()
        for each in sorted(path.iterdir()) if path.is_dir() else [path]:
            if mistake := _mistake_in_database(each):
                raise DecodeError(f"{printable(str(each))} cannot be read: {mistake}")
        if self._is_ros1:
            from rosbags.rosbag1 import Reader
        else:
            # Another class of the same name, with the same methods.
            from rosbags.rosbag2 import Reader  # type: ignore[assignment]
        try:
            self._reader: Any = Reader(path)
            self._reader.open()
        except OSError:
            raise
        except Exception as error:  # rosbags raises what its parts do
            raise self._unreadable(error) from error
        self._is_packed = False
        self._unpack_here()
        self._channels = {self._key(each): self._channel(each) for each in self._reader.connections}
        has_messages = self._reader.message_count > 0
        self.start_ns = int(self._reader.start_time) if has_messages else 0
        self.end_ns = int(self._reader.end_time) - 1 if has_messages else 0

    def _unpack_here(self) -> None:
        """Have rosbags unpack no more than may be: it takes whatever comes."""
        if self._is_ros1:
            from rosbags.rosbag1.reader import decompressors

            bounded = {
                decompressors[name]: partial(unpack, most=MOST_CHUNK_BYTES)
                for name, unpack in (("bz2", of_bz2), ("lz4", of_lz4))
            }
            chunks = self._reader.chunks
            for at, chunk in chunks.items():
                unpack = bounded.get(chunk.decompressor, chunk.decompressor)
                chunks[at] = chunk._replace(decompressor=unpack)
        elif self._reader.compression_mode == "message":
            self._is_packed = True
            storage = self._reader.storage
            storage.metadata = storage.metadata._replace(compression_mode=None)

    def close(self) -> None:
        """Close the file."""
        self._reader.close()

    @property
    def damage(self) -> list[str]:
        """Nothing: rosbags reads all, or raises."""
        return []

    def messages(self) -> Iterator[ForeignMessage]:
        """All messages in order of log time. Raises DecodeError if the file is damaged."""
        try:
            for connection, log_ns, data in self._reader.messages(self._reader.connections):
                if self._is_packed:
                    data = of_zstd(bytes(data), MOST_CHUNK_BYTES)
                yield ForeignMessage(log_ns, self._channels[self._key(connection)], bytes(data))
        except OSError:
            raise
        except Exception as error:
            raise self._unreadable(error) from error

    @staticmethod
    def _key(connection: Any) -> tuple[int, int]:
        return connection.id, id(connection.owner)

    def _channel(self, connection: Any) -> ForeignChannel:
        form = _DEFINITION_FORMATS.get(connection.msgdef.format.value, "")
        definition = connection.msgdef.data
        if not form and not self._is_ros1:
            definition = _known_definition(connection.msgtype)
            form = "msg" if definition else ""
        return ForeignChannel(
            connection.topic,
            ros_type_name(connection.msgtype),
            "ros1" if self._is_ros1 else "cdr",
            f"{'ros1' if self._is_ros1 else 'ros2'}{form}" if form else "",
            definition,
            (connection.ext.callerid or "") if self._is_ros1 else "",
            self._is_retained(connection),
        )

    def _is_retained(self, connection: Any) -> bool:
        if self._is_ros1:
            return bool(connection.ext.latching == 1)
        profiles = connection.ext.offered_qos_profiles
        return any(each.durability.name == "TRANSIENT_LOCAL" for each in profiles)

    def _unreadable(self, error: Exception) -> DecodeError:
        said = str(error).replace(f"File {str(self._path)!r} ", "it ") or type(error).__name__
        if "not indexed" in said:
            said = "it was not closed: `rosbag reindex` of ROS 1 repairs it"
        return DecodeError(f"{self.name} cannot be read: {said}")


def _mistake_in_database(path: Path) -> str:
    """Why a database is not one that rosbag2 wrote, "" if it may be.

    A view, a trigger, a virtual table or a computed column is a program: it can have a query go on
    for ever, which no signal ends. Its metadata may give it any name.
    """
    if not path.is_file():
        return ""
    with path.open("rb") as file:
        if file.read(len(_SQLITE)) != _SQLITE:
            return ""
    try:
        database = sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro&immutable=1", uri=True)
    except sqlite3.Error:
        return ""  # rosbags says why
    try:
        for kind, name, sql in database.execute("SELECT type, name, sql FROM sqlite_master"):
            is_plain = kind in ("table", "index") and "VIRTUAL" not in str(sql).upper().split()
            if is_plain and kind == "table":
                query = "SELECT count(*) FROM pragma_table_xinfo(?) WHERE hidden != 0"
                is_plain = database.execute(query, (name,)).fetchone() == (0,)
            if not is_plain:
                return (
                    f"{printable(str(name), 60)!r} in it is computed, which rosbag2 does not write"
                )
    except (sqlite3.Error, UnicodeDecodeError):
        return ""
    finally:
        database.close()
    return ""


def _known_definition(type_name: str) -> str:
    """The definition of a type that comes with ROS 2, "" of another: before Iron the files of
    rosbag2 had none.
    """
    from rosbags.typesys import Stores, get_typestore

    try:
        text, _ = get_typestore(Stores.ROS2_HUMBLE).generate_msgdef(type_name, ros_version=2)
    except Exception:  # rosbags raises what its parts do
        return ""
    return str(text)
