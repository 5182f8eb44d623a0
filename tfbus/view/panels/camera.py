"""Buttons and keys that move the camera of the browser that they are used in."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import viser

_NOTE_S = 4.0


@dataclass(frozen=True)
class CameraActions:
    """Their actions, by the number of the client: `focus` says why it cannot, "" if it can."""

    show_all: Callable[[int], object]
    focus: Callable[[int], str]


def add_camera_commands(gui: viser.GuiApi, actions: CameraActions) -> None:
    """Add them: H shows all, and F the selected frame; a note of 4 s says why it cannot."""

    def on_all(event: Any) -> None:
        if event.client is not None:
            actions.show_all(event.client.client_id)

    def on_focus(event: Any) -> None:
        if event.client is None or not (why := actions.focus(event.client.client_id)):
            return
        event.client.add_notification("Nothing to look at", why, auto_close_seconds=_NOTE_S)

    def on_click(event: Any) -> None:
        (on_all if buttons.value == _ALL else on_focus)(event)

    buttons = gui.add_button_group(
        "Look at", (_ALL, _SELECTED), hint="Moves only your camera. Keys: H all, F the selected."
    )
    buttons.on_click(on_click)
    gui.add_command("Look at all frames", hotkey="H").on_trigger(on_all)
    gui.add_command("Look at the selected frame", hotkey="F").on_trigger(on_focus)


_ALL = "All (H)"
_SELECTED = "Selected (F)"
