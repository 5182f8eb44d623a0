"""The turtles' controls: keys that drive and rotate, and buttons for the simulator's services."""

import json
import math
from collections.abc import Callable
from html import escape
from typing import Any

import viser

from tfbus.view.panels.markup import Channel, Html

from .. import field
from .turtles import KEYS, Turtles

# About the middle, with few enough digits for the fields.
_MIDDLE = (round(field.MIDDLE_M, 1), round(field.MIDDLE_M, 1), 0.0)

# The keys as on a keyboard, around F; beside them the arrows.
_PAD = (
    ("e", "E ↖", "rotate to 135°"), ("r", "R ↑", "rotate to 90°"), ("t", "T ↗", "rotate to 45°"),
    None, None, ("up", "▲", "drive forward"), None,
    ("d", "D ←", "rotate to 180°"), ("f", "F", "cancel the rotation"),
    ("g", "G →", "rotate to 0°"),
    None, ("left", "◀", "turn left"), None, ("right", "▶", "turn right"),
    ("c", "C ↙", "rotate to -135°"), ("v", "V ↓", "rotate to -90°"),
    ("b", "B ↘", "rotate to -45°"),
    None, None, ("down", "▼", "drive back"), None,
)  # fmt: skip


STYLE = """
.tf-pad { display: grid; grid-template-columns: repeat(3, 1fr) 0.5em repeat(3, 1fr); gap: 4px; }
.tf-pad button { all: unset; cursor: pointer; text-align: center; padding: 0.45em 0;
  border-radius: 4px; background: light-dark(#e7f1fb, #1c3a57); user-select: none;
  touch-action: none; }
.tf-pad button:hover { background: light-dark(#d0e4f7, #27507a); }
.tf-pad button:active { background: #228be6; color: white; }
.tf-pad button:focus-visible { outline: 2px solid #228be6; }
.tf-keys { margin-top: 0.5em; padding: 0.35em; text-align: center; cursor: pointer;
  border: 1px dashed var(--mantine-color-dimmed); border-radius: 4px; }
.tf-keys:focus { outline: none; border: 1px solid #228be6; background: #228be626; }
.tf-keys:focus .tf-off, .tf-keys:not(:focus) .tf-on { display: none; }
"""

# An arrow drives while its button is held down. Of typed keys only KEYS are taken.
SCRIPT = (
    f"window.tfbusKeys = {json.dumps(KEYS)};"
    + """
window.tfbusHold = (button, key) => {
  clearInterval(window.tfbusHeld);
  tfbus({do: 'key', key});
  const again = () => button.matches(':active') ? tfbus({do: 'key', key}) : clearInterval(held);
  const held = window.tfbusHeld = setInterval(again, 100);
};
window.tfbusKey = (event) => {
  const key = {ArrowUp: 'up', ArrowDown: 'down', ArrowLeft: 'left', ArrowRight: 'right'}[event.key]
    || event.key.toLowerCase();
  if (event.ctrlKey || event.metaKey || event.altKey || !window.tfbusKeys.includes(key)) return;
  event.preventDefault();
  event.stopPropagation();
  tfbus({do: 'key', key});
};
"""
)


class TurtlePanel:
    """Calls services of the simulator and its turtles, and shows the replies."""

    def __init__(self, gui: viser.GuiApi, turtles: Turtles, channel: Channel) -> None:
        self._turtles = turtles
        self._turtle = gui.add_dropdown("Turtle", ("turtle1",))
        self._pad = Html(gui.add_html(_pad()))
        self._reply = Html(gui.add_html(""))
        place = gui.add_vector3(
            "x, y, °",
            _MIDDLE,
            min=(0.0, 0.0, -360.0),
            max=(field.SIZE_M, field.SIZE_M, 360.0),
            step=0.1,
            hint="Where to teleport or spawn: metres from the lower left corner, and degrees.",
        )
        name = gui.add_text("New name", "", hint="Empty: the next free turtleN.")

        def chosen() -> tuple[float, float, float]:
            x, y, degrees = place.value
            return x, y, math.radians(degrees)

        def button(group: viser.GuiButtonGroupHandle, acts: dict[str, Callable[[], None]]) -> None:
            group.on_click(lambda event: acts[group.value]())

        button(
            gui.add_button_group("Call", ("Teleport", "Spawn", "Kill")),
            {
                "Teleport": lambda: turtles.teleport(self._turtle.value, *chosen()),
                "Spawn": lambda: turtles.spawn(*chosen(), name.value),
                "Kill": lambda: turtles.kill(self._turtle.value),
            },
        )
        button(
            gui.add_button_group("Field", ("Clear", "Reset")),
            {"Clear": turtles.clear, "Reset": turtles.reset},
        )
        channel.on("key", self._press)

    def refresh(self) -> None:
        """Show which turtles there are, and the last reply."""
        names = self._turtles.names or ("turtle1",)
        if self._turtle.options != names:
            self._turtle.options = names
        reply = escape(self._turtles.reply) or "&nbsp;"
        self._reply.show(f'<div class="tf" role="log" aria-label="reply">{reply}</div>')

    def _press(self, event: Any) -> None:
        self._turtles.press(self._turtle.value, str(event.get("key")))


def _pad() -> str:
    cells = "".join(
        "<span></span>"
        if key is None
        else f'<button title="{key[2]}" aria-label="{key[2]}" '
        f'onpointerdown="{_action(key[0])}">{key[1]}</button>'
        for key in _PAD
    )
    return (
        f'<div class="tf"><div class="tf-pad">{cells}</div>'
        '<div class="tf-keys" tabindex="0" role="application" aria-label="drive by keyboard" '
        'onkeydown="tfbusKey(event)"><span class="tf-off">Click here to drive by keyboard</span>'
        '<span class="tf-on">Arrows drive, E R T D G C V B rotate, F cancels</span></div></div>'
    )


def _action(key: str) -> str:
    """The event of a button: an arrow repeats while it is held, other keys act once."""
    if key in ("up", "down", "left", "right"):
        return f"tfbusHold(this, '{key}')"
    return f"tfbus({{do: 'key', key: '{key}'}})"
