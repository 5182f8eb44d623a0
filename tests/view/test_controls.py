"""Controls that browsers and the program change at once: no choice is lost."""

import asyncio
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import pytest

pytest.importorskip("viser", reason="needs viser: the extra view")

from tfbus.view.frames import Frames
from tfbus.view.panels.controls import Control, DisplayPanel, FrameDropdown
from tfbus.view.panels.markup import Channel
from tfbus.view.settings import Selections, TopicSettings, ViewSettings, ViewState


class Handle(SimpleNamespace):
    """A control of viser's: it sets the value first, and calls back when its loop comes to it."""

    def on_update(self, callback: Callable[[Any], Any]) -> None:
        self.callback = callback

    def set_by(self, value: object, client: int = 1) -> Callable[[], None]:
        """A browser sets a value; what viser's loop does next."""
        self.value = value
        event = SimpleNamespace(client=object(), client_id=client)
        return lambda: asyncio.run(self.callback(event))


class Gui:
    """A panel of viser's that knows dropdowns."""

    def add_dropdown(self, label: str, options: tuple[str, ...], hint: str | None) -> Handle:
        self.handle = Handle(options=options, value=options[0], order=1.0)
        return self.handle


@pytest.fixture
def dropdown() -> tuple[FrameDropdown, Handle, list[str]]:
    """A dropdown of three frames, viser's part of it, and what was chosen."""
    gui: Any = Gui()
    chosen: list[str] = []
    made = FrameDropdown(gui, "Frame", "automatic", chosen.append)
    made.offer(["arm", "base", "map"], "")
    return made, gui.handle, chosen


def test_a_choice_survives_a_refresh_that_does_not_know_it_yet(dropdown: Any) -> None:
    """The settings follow a moment after viser has the value."""
    made, handle, chosen = dropdown
    tell = handle.set_by("base")
    made.offer(["arm", "base", "map"], "")
    assert handle.value == "base"
    tell()
    assert chosen == ["base"]


def test_a_choice_survives_that_the_first_entry_is_renamed(dropdown: Any) -> None:
    """Also the choice of that entry itself."""
    made, handle, chosen = dropdown
    tell = handle.set_by("base")
    made.offer(["arm", "base", "map"], "", "automatic (map)")
    tell()
    handle.set_by("automatic")()
    assert chosen == ["base", ""]


def test_a_frame_may_have_the_name_of_the_first_entry(dropdown: Any) -> None:
    """No two entries are alike, with which a browser shows nothing at all; each can be chosen."""
    made, handle, chosen = dropdown
    for _ in range(2):
        made.offer(["arm", "automatic"], "")
        assert handle.options == ("(automatic)", "arm", "automatic")
        assert handle.value == "(automatic)"
    handle.set_by("automatic")()
    handle.set_by("(automatic)")()
    made.offer(["arm", "automatic", "(automatic)"], "automatic")
    assert handle.options[0] == "((automatic))"
    assert handle.value == "automatic"
    assert chosen == ["automatic", ""]


def test_a_change_by_the_program_is_shown_after_a_choice(dropdown: Any) -> None:
    """Also back to what was shown before it."""
    made, handle, _ = dropdown
    for before in ("arm", ""):
        made.offer(["arm", "base", "map"], before)
        handle.set_by("base")()
        made.offer(["arm", "base", "map"], before)
        assert handle.value == (before or "automatic")


def test_a_setting_keeps_what_a_browser_chose_before_a_refresh() -> None:
    """Of a slider, as in the tab View."""
    view = ViewState(ViewSettings())
    handle = Handle(value=view.settings.scale)
    control = Control(handle, lambda value: view.change(scale=value))
    tell = handle.set_by(2.5)
    control.show(view.settings.scale)
    tell()
    control.show(view.settings.scale)
    assert handle.value == view.settings.scale == 2.5


def typed(page: str, *frames: str, first: int = 1) -> str:
    """The text of a page that has selected frames, one event after another."""
    events = [
        {"do": "select", "frame": name, "n": number} for number, name in enumerate(frames, first)
    ]
    return json.dumps({"page": page, "events": events})


def test_each_event_is_taken_from_its_browser_once_and_in_order() -> None:
    """Although all browsers type into one field, and each types its events again."""
    channel, field = Channel(), Handle(value="")
    taken: list[tuple[int, str]] = []
    channel.on("select", lambda event: taken.append((event["client"], event["frame"])))
    channel.listen(field)
    for client, text in (
        (1, typed("a", "arm")),
        (2, typed("b", "base")),
        (1, typed("a", "arm", "map", "tool")),
        (2, typed("b", "base")),
        (1, typed("a", "map", "tool", first=2)),
    ):
        field.set_by(text, client)()
    assert taken == [(1, "arm"), (2, "base"), (1, "map"), (1, "tool")]


@pytest.mark.parametrize(
    "text",
    ["", "3", "[" * 100_000, "{}", '{"page": 1, "events": 2}', '{"page": "a", "events": [3]}']
    + [
        f'{{"page": "a", "events": [{{"do": "select", "n": {n}}}]}}'
        for n in ("NaN", '"x"', "1e999")
    ],
)
def test_a_text_that_is_no_list_of_events_is_ignored(text: str) -> None:
    """Any program may type it."""
    channel = Channel()
    channel.on("select", lambda event: pytest.fail(str(event)))
    channel.read(text, 1)


def test_a_file_of_settings_replaces_them_and_a_wrong_one_does_not() -> None:
    """A browser loads the file that it downloaded; of a wrong file one sentence says why not."""
    gui, view = MagicMock(), ViewState(ViewSettings(follow="base"))
    gui.add_text.side_effect = lambda label, value, hint: Handle(value=value)
    told: list[Any] = []
    gui.add_html.side_effect = lambda content: told.append(Handle(content=content)) or told[-1]
    buttons = {"Download settings": MagicMock(), "Save settings": MagicMock()}
    gui.add_button.side_effect = lambda label, **options: buttons[label]
    panel = DisplayPanel(gui, view, Selections(), Path("view.yaml"))
    [[download], _] = buttons["Download settings"].on_click.call_args
    [[load], _] = gui.add_upload_button.return_value.on_upload.call_args
    browser = MagicMock()
    plan = TopicSettings("plan", group="navigation", rgb="#0a0b0c", hidden=("x",))
    chosen = replace(view.settings, only="^a", topics=(plan,), hidden_groups=("navigation",))
    view.load(chosen)
    download(SimpleNamespace(client=browser, client_id=1))
    [[name, content], _] = browser.send_file_download.call_args

    def comes(content: bytes) -> str:
        file = SimpleNamespace(name="nav.yaml", content=content)
        load(SimpleNamespace(target=SimpleNamespace(value=file)))
        return str(told[-1].content)

    view.load(ViewSettings(dark=True))
    assert name == "view.yaml"
    assert "Loaded nav.yaml" in comes(content)
    assert view.settings == chosen
    panel.refresh(Frames())
    for wrong, said in (
        (b"topics: [{topic: a, size: <b>}]", "nav.yaml: size must be a number"),
        (b"\xff", "nav.yaml is no text"),
        (b" " * 2_000_000, "too large"),
        (b"3", "not a map of settings"),
    ):
        answer = comes(wrong)
        assert said in answer
        assert "<b>" not in answer
        assert view.settings == chosen
