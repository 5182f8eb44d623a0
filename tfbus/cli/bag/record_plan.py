"""The options of `tfbus bag record` on its command line."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from tfbus.bag.keeping import Splits, existing_parts, is_folder, path_of_recording
from tfbus.bag.trigger import Condition
from tfbus.errors import InvalidArgumentException
from tfbus.recording.selection import Selection, is_of_transforms
from tfbus.recording.writer import Compression
from tfbus.wire.keys import check_no_transforms
from tfbus.wording import printable

# What may wait to be written, and what is held for a snapshot.
_CACHE_BYTES = 100_000_000
_SNAPSHOT_CACHE_BYTES = 500_000_000


@dataclass(frozen=True)
class Plan:
    """The plan of a recording. `cache_bytes` is how much may wait to be written, or is held for a
    snapshot; None is 100 MB, or 500 MB for a snapshot.
    """

    path: Path
    selection: Selection
    everywhere: bool
    splits: Splits
    compression: Compression
    cache_bytes: int | None
    snapshot_s: float | None
    conditions: tuple[Condition, ...]
    with_history: bool
    starts_paused: bool
    has_keys: bool
    most_files: int | None
    custom_data: Mapping[str, str]

    @property
    def most_bytes(self) -> int:
        """How much may wait, or is held."""
        return self.cache_bytes or (_SNAPSHOT_CACHE_BYTES if self.snapshot_s else _CACHE_BYTES)


def free_path(output: str | None) -> Path:
    """The file to write. Raises InvalidArgumentException if it, or a part of it, is there."""
    path = path_of_recording(output)
    if output is not None and is_folder(output):
        _make_folder(path.parent)
    elif not path.parent.is_dir():
        raise InvalidArgumentException(
            f"there is no folder '{printable(str(path.parent))}' to record into: make it, or end "
            "its name with '/' and have a file in it named by the time"
        )
    taken = existing_parts(path)
    if taken:
        raise InvalidArgumentException(
            f"'{printable(str(taken[0]))}' is there already, and recordings are never overwritten: "
            "give another name (-o)"
        )
    return path


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InvalidArgumentException(
            f"could not make the folder '{printable(str(folder))}': {error.strerror or error}"
        ) from error


def pairs_of(texts: Iterable[str]) -> dict[str, str]:
    """The pairs in texts such as `driver=Ada`; of a key that comes twice the last counts.

    Raises InvalidArgumentException for another form.
    """
    pairs = {}
    for text in texts:
        key, sign, value = text.partition("=")
        if not (key and sign and text.isprintable()):
            raise InvalidArgumentException(f"'{printable(text, 60)}' is not of the form KEY=VALUE")
        pairs[key] = value
    return pairs


def checked(selection: Selection) -> Selection:
    """The selection. Raises InvalidNameError for a topic that no node can have."""
    for topic in selection.topics:
        if not is_of_transforms(topic):
            check_no_transforms(topic)
    return selection
