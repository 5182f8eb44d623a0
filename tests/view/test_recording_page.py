"""`tfbus view --bag`: the page of a recording in a real headless Chromium, and as a process."""

import re
import struct
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from signal import SIGINT, SIGTERM
from typing import Any

import pytest

from tests import needs
from tests.live_bus import Bus, Process, free_port
from tests.view.pages import PATIENCE_S, View, eventually
from tests.view.recordings import at, record
from tfbus import Buffer, InvalidArgumentException, Recording
from tfbus.view import show

# No bus is there to be joined: a view that tried would fail.
NO_BUS = ("--connect", "tcp/127.0.0.1:1")


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """A recording of 12 s."""
    return record(tmp_path / "arm.mcap")


def start(bus: Bus, path: Path, *options: str) -> tuple[Process, str]:
    """The view as a process, and its address."""
    pytest.importorskip("viser", reason="needs viser: the extra view")
    process = bus.start(
        *("view", *NO_BUS, "--bag", str(path), "--port", str(free_port()), "--rate", "5", *options)
    )
    line = process.wait_for_line(r"^View: http://", timeout_s=PATIENCE_S)
    return process, line.removeprefix("View: ")


def time_of(view: View) -> float:
    """The time that the bar shows, in seconds since the beginning."""
    shown = view.page.locator(".tfp-times").inner_text()
    minutes, seconds = re.findall(r"(\d+):(\d\d\.\d)\d* /", shown)[0]
    return 60 * int(minutes) + float(seconds)


def wait_for_time(view: View, seconds: float) -> None:
    """Wait until the bar shows this time."""
    eventually(lambda: abs(time_of(view) - seconds) < 0.06)


def is_held(view: View) -> bool:
    """Whether it stands still, held here or, on a busy machine, at its end before."""
    from playwright.sync_api import TimeoutError as NotShownError

    with suppress(NotShownError):
        view.page.get_by_label("Pause", exact=True).click(timeout=5e3)
    return view.shows(view.page.get_by_label("Play", exact=True), 5.0)


def drag(view: View, start_s: float, end_s: float) -> None:
    """Drag the cursor of the timeline from one time to another."""
    box = view.page.locator(".tfp-track").bounding_box()
    x, y = box["x"], box["y"] + box["height"] / 2
    view.page.mouse.move(x + box["width"] * start_s / 12.0, y)
    view.page.mouse.down()
    view.page.mouse.move(x + box["width"] * end_s / 12.0, y, steps=3)
    view.page.mouse.up()


def test_a_recording_plays_and_is_sought_in_a_browser(bus: Bus, path: Path, pages: Any) -> None:
    """Its states are those of then, in all browsers."""
    _, address = start(bus, path)
    view = View(pages.new_page(), address)
    view.headline("3 frames, seen from map")
    eventually(lambda: time_of(view) > 0.5)
    eventually(lambda: is_held(view))
    view.button("To the beginning")
    wait_for_time(view, 0.0)
    view.page.get_by_title("Go to the next: gone").click()
    wait_for_time(view, 5.0)
    view.wait_for_status("base", "gone")
    view.wait_for_status("lamp", "static")
    drag(view, 5.0, 3.6)
    view.wait_for_status("base", "stale")
    eventually(lambda: 3.3 < time_of(view) < 3.9)
    view.button("List of events")
    view.page.get_by_text("'base' published by 'sim' and 'twin'").click()
    wait_for_time(view, 8.0)
    view.wait_for_status("base", "conflict")

    other = View(pages.new_page(), address)
    other.wait_for_status("base", "conflict")
    other.button("To the beginning")
    for each in (view, other):
        each.wait_for_status("base", "dynamic")
        wait_for_time(each, 0.0)
    assert view.errors == other.errors == []


def test_keys_play_seek_and_step(bus: Bus, path: Path, pages: Any) -> None:
    """The keys are those of players of films; on the timeline the arrows."""
    _, address = start(bus, path, "--at", "+2s")
    view = View(pages.new_page(), address)
    view.wait_for_status("base", "dynamic")
    wait_for_time(view, 2.0)
    keys = view.page.keyboard
    for key, seconds in ((".", 4.0), (",", 2.0), ("l", 7.0), ("j", 2.0), ("n", 5.0), ("p", 2.0)):
        keys.press(key)
        wait_for_time(view, seconds)
    keys.press("End")
    wait_for_time(view, 12.0)
    keys.press("]")
    speed = view.page.get_by_label("speed")
    eventually(lambda: speed.input_value() == "2")
    view.page.get_by_role("slider", name="time in the recording").focus()
    keys.press("ArrowLeft")
    wait_for_time(view, 11.0)
    keys.press("Home")
    wait_for_time(view, 0.0)
    keys.press("Space")
    eventually(lambda: time_of(view) > 0.5)
    assert view.errors == []


def test_silences_have_a_mark_in_the_timeline(bus: Bus, path: Path, pages: Any) -> None:
    """The tip at the pointer names it, and follows when the track moves below the pointer; the
    legend counts each kind.
    """
    _, address = start(bus, path, "--at", "+1s")
    view = View(pages.new_page(), address)
    view.page.get_by_title("Go to the next: silent").wait_for()
    legend = view.page.locator(".tfp-legend").inner_text()
    assert re.findall(r"\d", legend) == ["2", "1", "1", "1"]

    def said_at_the_gap() -> str:
        # The track moves while the page settles.
        box = view.page.locator(".tfp-track").bounding_box()
        view.page.mouse.move(box["x"] + box["width"] * 3.0 / 12.0, box["y"] + 20)
        return str(view.page.locator(".tfp-tip").inner_text())

    eventually(lambda: "'sim' silent for 2.0 s" in said_at_the_gap())

    before = view.page.locator(".tfp-tip").inner_text()
    view.page.set_viewport_size({"width": 900, "height": 600})
    eventually(lambda: view.page.locator(".tfp-tip").inner_text() != before)


@pytest.mark.real
@pytest.mark.parametrize("signal", [SIGINT, SIGTERM])
def test_a_signal_ends_it_quietly(bus: Bus, path: Path, signal: int) -> None:
    """As it ends a view of the bus; all that it says is that it loads the page, and the address."""
    process, _ = start(bus, path)
    process.signal(signal)
    assert process.wait() == 0
    assert process.out == []
    loading, address = process.err
    assert loading == "Loading the page ..." and address.startswith("View: ")


@pytest.mark.real
def test_a_picture_shows_the_moment_that_is_asked_for(bus: Bus, path: Path, tmp_path: Path) -> None:
    """Of the given size, without a bus; then the process ends by itself."""
    needs.program("chromium")
    pytest.importorskip("viser", reason="needs viser: the extra view")
    picture = tmp_path / "out.png"
    done = bus.run(
        *("view", *NO_BUS, "--bag", str(path), "--at", "+5.5s", "--port", str(free_port())),
        *("--screenshot", str(picture), "--after", "0", "--size", "640x480"),
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout == f"Wrote {picture}\n"
    written = picture.read_bytes()
    assert written[:8] == b"\x89PNG\r\n\x1a\n"
    assert struct.unpack(">II", written[16:24]) == (640, 480)


@pytest.mark.parametrize(
    ("options", "code", "said"),
    [
        (("--at", "+1s"), 2, "--at is a moment of a recording: give --bag"),
        (("--bag", "PATH", "--at", "+99s"), 2, "is outside of the recording"),
        (("--bag", "PATH", "--from", "+9s", "--to", "+3s"), 2, "must be before --to"),
        (("--bag", "NONE"), 2, "does not exist"),
        (("--bag", "TEXT"), 1, "is not a recording"),
    ],
)
def test_a_mistake_is_said_in_a_sentence(
    bus: Bus, path: Path, tmp_path: Path, options: tuple[str, ...], code: int, said: str
) -> None:
    """With the exit codes of all tools, and no traceback."""
    text = tmp_path / "text.mcap"
    text.write_text("no recording\n" * 100)
    names = {"PATH": str(path), "NONE": str(tmp_path / "none.mcap"), "TEXT": str(text)}
    done = bus.run("view", *NO_BUS, *(names.get(option, option) for option in options))
    assert done.returncode == code
    assert said in " ".join(done.stderr.split())
    assert "Traceback" not in done.stderr


@pytest.mark.real
def test_a_program_shows_a_recording_and_moves_it(path: Path) -> None:
    """The page has files of its own: the program may close the recording."""
    pytest.importorskip("viser", reason="needs viser: the extra view")
    with Recording(path) as recording:
        view = show(recording, port=free_port(), rate_hz=5.0, at_ns=at(3.0))
    with view:
        assert view.at_ns == at(3.0)
        view.seek(at(99.0))
        assert view.at_ns == at(12.0)
        view.play(speed=0.3)
        assert view.at_ns == at(0.0)
        view.pause()
        replay = view._replay()
        assert (replay.playhead.progress.is_paused, replay.playhead.progress.rate) == (True, 0.3)
        view.seek(at(5.5))
        eventually(
            lambda: replay.moment().now_ns == at(5.5) and replay.moment().tree.frames["base"].gone
        )


CALLS: dict[str, Callable[[Any], object]] = {
    "seek": lambda view: view.seek(0),
    "play": lambda view: view.play(),
    "pause": lambda view: view.pause(),
    "at_ns": lambda view: view.at_ns,
}


@pytest.mark.real
def test_a_buffer_is_not_played() -> None:
    """The error says what can be."""
    pytest.importorskip("viser", reason="needs viser: the extra view")
    with show(Buffer(), port=free_port(), rate_hz=5.0) as view:
        for call in CALLS.values():
            with pytest.raises(InvalidArgumentException, match="only a recording"):
                call(view)
    with pytest.raises(InvalidArgumentException, match=r"at_ns .*recording"):
        show(Buffer(), port=free_port(), at_ns=1)
