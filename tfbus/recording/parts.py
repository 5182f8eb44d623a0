"""The files of one recording."""

import os
from collections.abc import Iterable
from pathlib import Path

from tfbus.errors import DecodeError
from tfbus.recording.mcap_file import how_to_import
from tfbus.wording import printable

SUFFIX = ".mcap"


def files_of(paths: Iterable[str | os.PathLike[str]]) -> list[Path]:
    """The files that these paths name: of a folder those in it that end in `.mcap`, by name.

    Raises FileNotFoundError for a path that is not there, and DecodeError for a folder without
    recordings.
    """
    found = [file for path in paths for file in _files_at(Path(path))]
    return list(dict.fromkeys(found))


def _files_at(path: Path) -> list[Path]:
    if not path.is_dir():
        return [path]
    files = sorted(each for each in path.iterdir() if each.suffix == SUFFIX and each.is_file())
    if not files:
        import_it = how_to_import(path)
        advice = f": {import_it}" if import_it else ""
        raise DecodeError(f"{printable(str(path))} is a folder without {SUFFIX} files{advice}")
    return files
