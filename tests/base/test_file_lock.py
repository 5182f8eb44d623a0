"""A lock of a folder or file, which one process holds at a time."""

import os
from contextlib import ExitStack, closing
from pathlib import Path

import pytest

from tests.fakes import InAThread
from tfbus.base import scheduler
from tfbus.base.file_lock import hold, is_held, locked


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


class _Copy:
    """A copy of a descriptor, as a forked child has one."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = os.dup(descriptor)

    def close(self) -> None:
        os.close(self._descriptor)


def test_a_child_that_lives_on_keeps_no_lock(tmp_path: Path) -> None:
    """A file's lock is free once its holder let go, though a forked child has the file open."""
    path = tmp_path / "file"
    with path.open("xb") as file, closing(_Copy(file.fileno())):
        let_go = hold(file)
        assert is_held(path)
        let_go()
        assert not is_held(path)


def test_a_child_that_lives_on_keeps_no_lock_of_a_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A folder's lock is free at the end of its `with`."""
    opened: list[int] = []
    system_open = os.open

    def note(*given: object) -> int:
        opened.append(system_open(*given))  # type: ignore[arg-type]
        return opened[-1]

    monkeypatch.setattr(os, "open", note)
    with locked(tmp_path, waits=False):
        copy = _Copy(opened[0])
    with closing(copy), locked(tmp_path, waits=False) as again:
        assert again


@pytest.mark.real
@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_a_child_that_ends_what_it_inherited_leaves_its_parent_the_locks(tmp_path: Path) -> None:
    """The lock of a file, and the lock of a folder."""
    path = tmp_path / "file"
    with path.open("xb") as file, ExitStack() as ending:
        let_go = hold(file)
        ending.enter_context(locked(tmp_path, waits=False))
        child = os.fork()
        if child == 0:
            let_go()
            ending.close()
            os._exit(0)
        os.waitpid(child, 0)
        assert is_held(path)
        with locked(tmp_path, waits=False) as again:
            assert not again


def test_it_is_held_though_somebody_asked_at_that_instant(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Somebody who asks has the lock until then, and it is tried again."""
    import fcntl

    path = tmp_path / "file"
    with path.open("xb") as file, path.open("rb") as asking:
        fcntl.flock(asking, fcntl.LOCK_SH)
        monkeypatch.setattr(scheduler, "sleep", lambda _: fcntl.flock(asking, fcntl.LOCK_UN))
        hold(file)
        assert is_held(path)
