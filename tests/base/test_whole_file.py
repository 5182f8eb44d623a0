"""Files that are replaced whole."""

import errno
from functools import partial
from pathlib import Path

import pytest

from tfbus import Buffer, Trajectory
from tfbus.base.whole_file import replacing
from tfbus.buffer.files import save


def test_an_error_names_the_file_that_was_given(tmp_path: Path) -> None:
    """Not the one that is written beside it."""
    missing = tmp_path / "none" / "t.csv"
    drive = Trajectory("map", "base", [1], [[0, 0, 0]])
    for write in (drive.write_csv, drive.write_tum, partial(save, Buffer())):
        with pytest.raises(FileNotFoundError) as caught:
            write(missing)
        assert (caught.value.errno, caught.value.filename) == (errno.ENOENT, str(missing))


def test_an_error_of_the_renaming_names_the_file_that_was_given(tmp_path: Path) -> None:
    """As where a folder has come in its place meanwhile."""
    place = tmp_path / "t.csv"
    with pytest.raises(OSError, match=r"directory: '[^>]*/t\.csv'$"), replacing(place):
        place.mkdir()
    assert list(tmp_path.iterdir()) == [place]
