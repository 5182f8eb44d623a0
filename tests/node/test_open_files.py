"""A process that comes to its limit of open files says so."""

import logging

import pytest

from tfbus.node.surroundings import OpenFilesWatch

resource = pytest.importorskip("resource")


def test_few_free_files_are_warned_of_once(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With 60 of 64 files open there is one warning, with 50 none."""
    monkeypatch.setattr(resource, "getrlimit", lambda which: (64, 64))
    watch = OpenFilesWatch(logging.getLogger("test"))
    monkeypatch.setattr("os.listdir", lambda folder: range(50))
    watch.check()
    assert not caplog.messages
    monkeypatch.setattr("os.listdir", lambda folder: range(60))
    watch.check()
    watch.check()
    [message] = caplog.messages
    assert message.startswith("60 of 64 open files")
