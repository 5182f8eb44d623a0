"""A buffer as people look at it."""

import sys
from types import SimpleNamespace
from typing import Any

import pytest

from tests.builders import S, moved
from tfbus import Buffer, InvalidArgumentException


def arm() -> Buffer:
    """An arm with a tool, a camera beside it, and a dock apart."""
    buffer = Buffer()
    buffer.set_transform(moved(1 * S, "base", "arm", 1.0), authority="joints")
    buffer.set_transform(moved(1 * S, "arm", "tool", 0.5), static=True)
    buffer.set_transform(moved(1 * S, "base", "camera", 2.0), static=True)
    buffer.set_transform(moved(1 * S, "yard", "dock", 2.0), static=True)
    return buffer


def test_show_prints_the_trees(capsys: pytest.CaptureFixture[str]) -> None:
    """Outside of a notebook it is text."""
    arm().show()
    assert capsys.readouterr().out.splitlines() == [
        "base",
        "├─ arm  (1 sample, by joints)",
        "│  └─ tool  (static)",
        "└─ camera  (static)",
        "yard",
        "└─ dock  (static)",
    ]


def test_show_marks_a_path_and_says_its_transform(capsys: pytest.CaptureFixture[str]) -> None:
    """The frames of the path have a star, the others none."""
    arm().show("base", "tool")
    lines = capsys.readouterr().out.splitlines()
    assert [line.split("  (")[0] for line in lines[:4]] == [
        "base *",
        "├─ arm *",
        "│  └─ tool *",
        "└─ camera",
    ]
    assert lines[-3:] == [
        "tool seen from base at 1.000000000 s:",
        "x, y, z in m: 1.500, 0.000, 0.000",
        "roll, pitch, yaw in degrees: 0.00, 0.00, 0.00",
    ]


def test_show_says_why_there_is_no_transform(capsys: pytest.CaptureFixture[str]) -> None:
    """For frames of separate trees, and for a time without data."""
    arm().show("base", "dock")
    assert "'base' and 'dock' are not connected" in capsys.readouterr().out
    arm().show("base", "tool", 5 * S)
    assert "no data for 'base' -> 'arm'" in capsys.readouterr().out


def test_show_says_that_a_frame_is_unknown(capsys: pytest.CaptureFixture[str]) -> None:
    """Below the trees, with the name that is meant; also of a buffer without frames."""
    arm().show("base", "toll")
    shown = capsys.readouterr().out.splitlines()
    assert shown[0] == "base *" and shown[-1].startswith("there is no frame 'toll'; did you mean")
    assert "there is no frame" in arm()._drawing("base", "toll", None)._repr_html_()
    Buffer().show("base", "toll")
    assert "there is no frame" in capsys.readouterr().out


def test_show_of_one_frame_alone_raises() -> None:
    """A path has two ends, and each has a name."""
    with pytest.raises(InvalidArgumentException, match="must not be empty"):
        arm().show("base", "")
    with pytest.raises(InvalidArgumentException, match="name two frames"):
        arm().show("base")


def test_an_empty_buffer_says_so(capsys: pytest.CaptureFixture[str]) -> None:
    """As text and as a drawing."""
    Buffer().show()
    assert capsys.readouterr().out == "no frames yet\n"
    assert "no frames yet" in Buffer()._repr_html_()
    assert "no frames yet" in Buffer()._repr_svg_()


def test_a_notebook_gets_a_drawing(monkeypatch: pytest.MonkeyPatch) -> None:
    """With the path in colour, and the transform below, all escaped."""
    shown: list[Any] = []
    notebook = SimpleNamespace(
        get_ipython=lambda: object(), display=SimpleNamespace(display=shown.append)
    )
    monkeypatch.setitem(sys.modules, "IPython", notebook)
    buffer = arm()
    buffer.set_transform(moved(1 * S, "base", "<b>"), static=True)
    buffer.show("base", "<b>")
    html = shown[0]._repr_html_()
    assert "<svg" in html
    assert html.count('stroke-width="3"') == 1
    assert "<b>" not in html
    assert "&lt;b&gt; seen from base" in html
