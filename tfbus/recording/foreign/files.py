"""Which files a foreign recording has, and what reads each."""

import re
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from heapq import merge
from pathlib import Path
from typing import Any

import yaml

from tfbus.errors import DecodeError
from tfbus.recording.foreign.bare_mcap import BareMcap
from tfbus.recording.foreign.messages import ForeignFile, ForeignMessage
from tfbus.recording.foreign.rosbags_file import RosbagsFile
from tfbus.wording import printable

ENDINGS = (".bag", ".db3", ".mcap")

_METADATA = "metadata.yaml"
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
        return merge(*(file.messages() for file in self.files), key=lambda message: message.log_ns)


@contextmanager
def opened(*paths: Path) -> Iterator[ForeignFiles]:
    """The files, or folders of files, as one until the end of the `with`.

    Raises DecodeError for a file of another kind and one that cannot be read, OSError, and
    ImportError where the library that reads it is not installed.
    """
    with ExitStack() as stack:
        files: list[ForeignFile] = []
        for path in (each for given in paths for each in _files_of(given)):
            is_mcap = path.suffix == ".mcap" and not path.is_dir()
            file: ForeignFile = BareMcap(path) if is_mcap else RosbagsFile(path)
            stack.callback(file.close)
            files.append(file)
        yield ForeignFiles(files)


def _files_of(path: Path) -> list[Path]:
    """The files, or the folder itself, that are opened one by one."""
    if not path.is_dir():
        if path.suffix not in ENDINGS:
            raise DecodeError(
                f"{printable(str(path))} is no recording that can be imported: its name should end "
                f"with {', '.join(ENDINGS)}, or be the folder of a recording of rosbag2"
            )
        return [path]
    found = sorted(
        (each for each in path.iterdir() if each.suffix in ENDINGS and each.is_file()),
        key=lambda each: _with_numbers(each.name),
    )
    if (path / _METADATA).is_file() and not _is_plain_mcap(_metadata(path), found):
        return [path]
    if not found:
        raise DecodeError(
            f"{printable(str(path))} holds no recording: no {_METADATA} of rosbag2, and no file "
            f"whose name ends with {', '.join(ENDINGS)}"
        )
    return found


def _is_plain_mcap(metadata: Any, found: list[Path]) -> bool:
    """Whether the files are MCAP as they are: rosbag2's metadata names no compression."""
    if not found or any(each.suffix != ".mcap" for each in found):
        return False
    try:
        mode = metadata["rosbag2_bagfile_information"].get("compression_mode", "")
    except (KeyError, TypeError, AttributeError):
        return True
    return str(mode).lower() in ("", "none")


def _metadata(folder: Path) -> Any:
    """What rosbag2's metadata says; None where it is not YAML, which rosbags says better. Raises
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


def _with_numbers(name: str) -> list[tuple[int, str]]:
    """For sorting, so that part 10 comes after part 9."""
    return [
        (int(part) if part.isdecimal() else -1, part) for part in re.split(r"(\d+)", name) if part
    ]
