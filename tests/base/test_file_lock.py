"""A lock of a folder, which one process holds at a time."""

from pathlib import Path

from tests.fakes import InAThread
from tfbus.base.file_lock import locked


def test_one_holds_it_at_a_time(tmp_path: Path) -> None:
    """Another one is told so, or waits until the first is done."""
    done: list[str] = []

    def wait() -> None:
        with locked(tmp_path, waits=True):
            done.append("waited")

    with locked(tmp_path, waits=False) as first:
        with locked(tmp_path, waits=False) as second:
            assert (first, second) == (True, False)
        waiting = InAThread(wait)
        done.append("held")
    waiting.result()
    assert done == ["held", "waited"]
    with locked(tmp_path, waits=False) as third:
        assert third
