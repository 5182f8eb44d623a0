"""Files of other programs, with transforms and topics: bags of ROS 1 and 2, and MCAP."""

import sqlite3
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from heapq import merge
from operator import attrgetter
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import yaml

from tfbus.base.errors import DecodeError
from tfbus.base.wording import natural_order, printable
from tfbus.recording.imported import (
    ForeignChannel,
    ForeignFile,
    ForeignMessage,
    ros_type_name,
)
from tfbus.recording.layout import is_retained
from tfbus.recording.mcap_file import McapFile
from tfbus.recording.reader import in_order
from tfbus.recording.records import (
    MOST_CHUNK_BYTES,
    Message,
    of_bz2,
    of_lz4,
    of_zstd,
    united,
    unpack_zstd_file,
)

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
        except Exception as error:  # rosbags raises any error of its parts
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
    except Exception:  # rosbags raises any error of its parts
        return ""
    return str(text)


# A channel's publisher, and whether it is retained, as the converter of rosbag1 names them.
_PUBLISHER, _LATCHING = "callerid", "latching"


class BareMcap:
    """An MCAP file. Raises DecodeError if it is none, or one of ours, and OSError.

    With `is_packed` each message is compressed for itself, as rosbag2 may do.
    """

    def __init__(self, path: Path, *, is_packed: bool = False) -> None:
        self._is_packed = is_packed
        self.name = printable(str(path))
        self._file = McapFile(path)
        if self._file.library.startswith("tfbus "):
            self._file.close()
            raise DecodeError(
                f"{self.name} is a recording of tfbus and needs no import: cut, merge and filter "
                "take it as it is"
            )
        self._chunks = sorted(self._file.chunks, key=attrgetter("from_ns"))
        self.start_ns = min((chunk.from_ns for chunk in self._chunks), default=0)
        self.end_ns = max((chunk.to_ns for chunk in self._chunks), default=0)
        self._channels: dict[int, ForeignChannel] = {}
        self.note = self._note()

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    @property
    def damage(self) -> list[str]:
        """The unreadable parts so far: `128 kB with 98 messages from +3.21s to +3.44s`."""
        return [each.text(self.start_ns) for each in united(self._file.damage)]

    def messages(self) -> Iterator[ForeignMessage]:
        """All readable messages in order of log time, whatever the order of the file."""
        for message in in_order(self._groups(), attrgetter("log_ns")):
            yield self._message(message)

    def _groups(self) -> Iterator[tuple[int, list[Message], int]]:
        for chunk in self._chunks:
            messages = self._file.messages(chunk)
            yield chunk.from_ns, messages, sum([len(message.data) for message in messages])

    def _note(self) -> str:
        if not self._file.is_complete:
            return f"{self.name} is cut short: what is there is read"
        return ""

    def _message(self, message: Message) -> ForeignMessage:
        channel = self._channels.get(message.channel)
        if channel is None:
            channel = self._channels[message.channel] = self._channel(message.channel)
        data = of_zstd(message.data, MOST_CHUNK_BYTES) if self._is_packed else message.data
        return ForeignMessage(message.log_ns, channel, data)

    def _channel(self, number: int) -> ForeignChannel:
        channel = self._file.channels[number]
        schema = self._file.schemas.get(channel.schema_id)
        if schema is None:
            return ForeignChannel(channel.topic, "", channel.encoding)
        is_text = schema.encoding in ("ros1msg", "ros2msg", "ros2idl", "jsonschema")
        return ForeignChannel(
            channel.topic,
            ros_type_name(schema.name),
            channel.encoding,
            schema.encoding,
            schema.data.decode(errors="replace") if is_text else "",
            channel.metadata.get(_PUBLISHER, ""),
            is_retained(channel.metadata) or channel.metadata.get(_LATCHING) == "1",
        )


ENDINGS = (".bag", ".db3", ".mcap")

_METADATA, _INFORMATION = "metadata.yaml", "rosbag2_bagfile_information"
_MOST_METADATA = 10_000_000


class ForeignFiles:
    """Several files as one: `start_ns` and `end_ns` are the log times of the first and the last
    message, both 0 without any.
    """

    def __init__(self, files: list[ForeignFile]) -> None:
        spans = [file for file in files if file.end_ns]
        self.files = files
        self.start_ns = min((file.start_ns for file in spans), default=0)
        self.end_ns = max((file.end_ns for file in spans), default=0)

    def messages(self) -> Iterator[ForeignMessage]:
        """The messages of all, in order of log time."""
        return merge(*(file.messages() for file in self.files), key=attrgetter("log_ns"))


@contextmanager
def opened(*paths: Path) -> Iterator[ForeignFiles]:
    """The files, or folders of files, as one until the end of the `with`.

    Raises DecodeError for a file of another kind and one that cannot be read, OSError, and
    ImportError if the library that reads it is not installed.
    """
    with ExitStack() as stack:
        files: list[ForeignFile] = []
        for given in paths:
            for file in _files_of(given, stack):
                stack.callback(file.close)
                files.append(file)
        yield ForeignFiles(files)


def _files_of(path: Path, stack: ExitStack) -> Iterator[ForeignFile]:
    """The files at a path; unpacked copies are there until the end of the stack."""
    if not path.is_dir():
        if path.suffix not in ENDINGS:
            raise DecodeError(
                f"{printable(str(path))} is no recording that can be imported: its name should end "
                f"with {', '.join(ENDINGS)}, or be the folder of a recording of rosbag2"
            )
        yield BareMcap(path) if path.suffix == ".mcap" else RosbagsFile(path)
        return
    mode = ""
    if has_metadata := (path / _METADATA).is_file():
        mode = _compression_mode(path)
        if mode == "file":
            path, mode = _unpacked(path, stack), ""
    found = sorted(
        (each for each in path.iterdir() if each.suffix in ENDINGS and each.is_file()),
        key=lambda each: natural_order(each.name),
    )
    if has_metadata and (not found or any(each.suffix != ".mcap" for each in found)):
        yield RosbagsFile(path)
        return
    if not found:
        raise DecodeError(
            f"{printable(str(path))} holds no recording: no {_METADATA} of rosbag2, and no file "
            f"whose name ends with {', '.join(ENDINGS)}"
        )
    for each in found:
        is_mcap = each.suffix == ".mcap"
        yield BareMcap(each, is_packed=mode == "message") if is_mcap else RosbagsFile(each)


def _compression_mode(folder: Path) -> str:
    """The compression in rosbag2's metadata: by "file", by "message", or "" for none."""
    try:
        mode = str(_metadata(folder)[_INFORMATION].get("compression_mode", "")).lower()
    except (KeyError, TypeError, AttributeError):
        return ""
    return "" if mode == "none" else mode


def _unpacked(folder: Path, stack: ExitStack) -> Path:
    """A copy of a folder of rosbag2 whose files are compressed, in which they are not."""
    plain = Path(stack.enter_context(TemporaryDirectory(prefix="tfbus-")))
    metadata = _metadata(folder)
    information = metadata[_INFORMATION]
    try:
        packed = [folder / Path(name).name for name in information["relative_file_paths"]]
        files = [plain / each.stem for each in packed]
    except (KeyError, TypeError) as error:
        raise DecodeError(f"{printable(str(folder / _METADATA))} names no files") from error
    for each, file in zip(packed, files, strict=True):
        try:
            unpack_zstd_file(each, file)
        except DecodeError as error:
            raise DecodeError(f"{printable(str(each))} cannot be read: {error}") from error
    names = {"compression_mode": "", "relative_file_paths": [file.name for file in files]}
    information = {**information, **names}
    (plain / _METADATA).write_text(yaml.safe_dump({**metadata, _INFORMATION: information}))
    return plain


def _metadata(folder: Path) -> Any:
    """The contents of rosbag2's metadata; None if it is not YAML, which rosbags says better. Raises
    DecodeError for one of more than 10 MB, or nested so deeply that rosbags would read for hours.
    """
    path = folder / _METADATA
    if path.stat().st_size > _MOST_METADATA:
        raise DecodeError(f"{printable(str(path))} has more than {_MOST_METADATA // 10**6} MB")
    try:
        return yaml.safe_load(path.read_text())
    except (yaml.YAMLError, ValueError):
        return None
    except RecursionError:
        raise DecodeError(f"{printable(str(path))} is nested too deeply") from None
