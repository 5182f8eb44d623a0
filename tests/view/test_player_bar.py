"""Requests of browsers to the bar that plays a recording, and the answers."""

import html
import json
import re
from types import SimpleNamespace
from typing import Any

import pytest

from tests.builders import S

pytest.importorskip("viser", reason="needs viser: the extra view")

from tfbus.recording.playhead import Playhead, Progress
from tfbus.view.panels.markup import Channel
from tfbus.view.panels.player import PlayerBar
from tfbus.view.timeline import Mark, Timeline

START, END = 1_795_252_263 * S, 1_795_252_273 * S


class Gui:
    """The elements and keys that a panel adds to viser."""

    def __init__(self) -> None:
        self.htmls: list[SimpleNamespace] = []
        self.keys: dict[str, Any] = {}

    def add_html(self, content: str) -> SimpleNamespace:
        self.htmls.append(SimpleNamespace(content=content))
        return self.htmls[-1]

    def add_command(self, label: str, hotkey: str) -> SimpleNamespace:
        def on_trigger(callback: Any) -> None:
            self.keys[hotkey] = callback

        return SimpleNamespace(on_trigger=on_trigger)

    def told(self, number: int) -> Any:
        """What an element says to the page's script, as JSON."""
        script = html.unescape(re.findall(r'onerror="([^"]*)"', self.htmls[number].content)[0])
        return json.JSONDecoder().raw_decode(script, script.index("(") + 1)[0]


@pytest.fixture
def gui() -> Gui:
    """A panel's part of viser."""
    return Gui()


@pytest.fixture
def playhead() -> Playhead:
    """Held at the beginning of ten seconds."""
    return Playhead(START, END, paused=True)


def bar(gui: Gui, playhead: Playhead, *marks: Mark) -> Channel:
    """The channel of a bar that has been drawn once."""
    channel = Channel()
    replay: Any = SimpleNamespace(playhead=playhead, timeline=Timeline(START, END, marks))
    made: Any = PlayerBar(gui, channel, replay)
    made.refresh()
    return channel


def test_browsers_are_told_where_the_playhead_is(gui: Gui, playhead: Playhead) -> None:
    """In seconds since the beginning."""
    playhead.seek(START + 2 * S)
    bar(gui, playhead)
    assert gui.told(0)["span"] == 10.0
    assert gui.told(1) == {"at": 2.0, "plays": False, "speed": 1.0, "loops": False, "jumps": 1}


def test_names_of_strangers_stay_text(gui: Gui, playhead: Playhead) -> None:
    """They end neither an attribute nor an element, and cannot turn the direction of writing."""
    name = """x' " onclick="f()"></div><script>f()</script>\u202e\ud800\n"""
    bar(gui, playhead, Mark("gone", START, END, "gone", (name,)))
    assert re.findall(r"<(\w+)", gui.htmls[0].content) == ["div", "img"]
    ((_, _, _, text),) = gui.told(0)["marks"]
    assert text.isprintable() and 'onclick="f()"' in text


@pytest.mark.parametrize(
    "event",
    [
        {"do": "seek", "n": 1},
        {"do": "seek", "n": 1, "s": "5"},
        {"do": "seek", "n": 1, "s": True},
        {"do": "seek", "n": 1, "s": float("nan")},
        {"do": "seek", "n": 1, "s": 1e300},
        {"do": "speed", "speed": "fast"},
        {"do": "speed", "speed": [2]},
        {"do": "play", "plays": "yes"},
        {"do": "loop", "loops": 1},
    ],
)
def test_events_that_no_browser_of_ours_sends_change_nothing(
    gui: Gui, playhead: Playhead, event: dict[str, object]
) -> None:
    """Any program may send them."""
    bar(gui, playhead).receive(event, 1)
    assert playhead.progress == Progress(START, END, START, is_paused=True)


def test_keys_move_the_playhead(gui: Gui, playhead: Playhead) -> None:
    """Also from mark to mark."""
    marks = [Mark("gone", START + at * S, END, f"gone {at}") for at in (2, 6)]
    bar(gui, playhead, *marks)
    seen = []
    for key in ("N", "N", "N", "P", "L", "J", "end", "home"):
        gui.keys[key](None)
        seen.append((playhead.progress.log_ns - START) / S)
    assert seen == [2.0, 6.0, 6.0, 2.0, 7.0, 2.0, 10.0, 0.0]
    gui.keys["space"](None)
    assert not playhead.progress.is_paused
