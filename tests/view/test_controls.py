"""Controls that browsers and the program change at once: no choice is lost."""

import asyncio
import json
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("viser", reason="needs viser: the extra view")

from tfbus.view.panels.controls import Control, FrameDropdown
from tfbus.view.panels.markup import Channel
from tfbus.view.settings import ViewSettings, ViewState


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


def test_each_event_is_taken_from_its_browser_in_order() -> None:
    """Although all browsers type into one field."""
    channel, field = Channel(), Handle(value="")
    taken: list[tuple[int, str]] = []
    channel.on("select", lambda event: taken.append((event["client"], event["frame"])))
    channel.listen(field)
    for client, frame in ((1, "arm"), (2, "base"), (1, "map")):
        field.set_by(json.dumps({"do": "select", "frame": frame}), client)()
    assert taken == [(1, "arm"), (2, "base"), (1, "map")]
