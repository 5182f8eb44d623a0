"""The tab of RViz's tools: a goal, an initial pose, a point, a distance and the selection of a
point, by the pointer on the scene.

A browser that has chosen a tool takes the next drag, or clicks, on the scene for it, in place of
the camera.
"""

import json
import math
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from html import escape
from typing import Any

import viser

from tfbus.base.wording import counted, printable
from tfbus.view.data.picked import PickedPoint
from tfbus.view.data.topics import TOOLS, Tool, ToolPublishers
from tfbus.view.panels.controls import Control
from tfbus.view.panels.markup import Channel, Html, event
from tfbus.view.settings import ViewState

# Names are typed letter by letter: the publishers follow once they have been left alone so long.
_AFTER_S = 1.0

# Aims that wait for the page; a script makes more.
_MOST_AIMS = 20

# The tools that send nothing. viser moves the camera by RViz's key of Select.
MEASURE, SELECT = "measure", "select"


@dataclass(frozen=True)
class _Finder:
    title: str
    key: str
    clicks: int
    done: str


FINDERS = {
    MEASURE: _Finder("Measure", "M", 2, "measured"),
    SELECT: _Finder("Select", "I", 1, "selected"),
}

# A message that nobody hears is not kept for later subscribers: robots would drive to old goals.
_UNHEARD = '; <b class="tf-alarm">nobody subscribed: send it again once somebody does</b>'

Place = tuple[float, float]


@dataclass(frozen=True)
class Aim:
    """The use of a tool, by its name, in a browser: where the drag began and ended, in parts of the
    picture's width and height from its upper left corner. Of a tool with several clicks it is the
    first if `is_first`.
    """

    client: int
    tool: str
    start: Place
    end: Place
    is_first: bool = True


class ToolsPanel:
    """Buttons of the tools, their topics, and the last messages, measure and selected point;
    without publishers there are only the tools that send nothing.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        view: ViewState,
        channel: Channel,
        publishers: ToolPublishers | None,
    ) -> None:
        self._view = view
        self.publishers = publishers
        self._aims: deque[Aim] = deque(maxlen=_MOST_AIMS)
        self._topics: tuple[str, ...] = ()
        self._changed_s = -math.inf
        # The last message of each tool, and whether anybody subscribed when it was sent.
        self._sent: dict[str, tuple[str, bool]] = {}
        self._found = dict.fromkeys(FINDERS, "")
        self._cleared: deque[str] = deque(maxlen=_MOST_AIMS)
        self._tools = TOOLS if publishers else {}
        gui.add_html(_buttons(self._tools))
        self._found_lines = Html(gui.add_html(""))
        self._controls = {
            tool.setting: Control(
                gui.add_text(f"{tool.title} on", tool.topic(view.settings)),
                _setter(view, tool.setting),
            )
            for tool in self._tools.values()
        }
        self._state = Html(gui.add_html(""))
        channel.on("tool", self._take)
        channel.on("unfind", self._clear)

    def refresh(self, now_s: float, subscribers: Callable[[str], int]) -> None:
        """Follow the settings, and show the sent messages; `now_s` is of a steady clock, and
        `subscribers(topic)` how many subscriptions there are.
        """
        self._found_lines.show("".join(map(_found_html, self._found, self._found.values())))
        if self.publishers is None:
            return
        settings = self._view.settings
        for name, control in self._controls.items():
            control.show(getattr(settings, name))
        topics = tuple(tool.topic(settings) for tool in TOOLS.values())
        if topics != self._topics:
            is_first, self._topics = not self._topics, topics
            self._changed_s = -math.inf if is_first else now_s
        if now_s - self._changed_s >= _AFTER_S:
            self.publishers.keep(settings)
        lines = []
        for tool in TOOLS.values():
            if why := self.publishers.mistakes.get(tool.name):
                lines.append(
                    f'<div class="tf-alarm" role="alert">{tool.title}: {escape(why)}</div>'
                )
            elif sent := self._sent.get(tool.name):
                text, was_heard = sent
                count = subscribers(self.publishers.topic(tool))
                told = f"; {counted(count, 'subscription')}" if count else ""
                lines.append(
                    f"<div>{tool.title}: {escape(text)}{told if was_heard else _UNHEARD}</div>"
                )
        self._state.show(f'<div class="tf" role="log" aria-label="sent">{"".join(lines)}</div>')

    def note(self, tool: Tool, sent: str, *, was_heard: bool) -> None:
        """Show the last message of a tool, and whether anybody subscribed to it."""
        self._sent[tool.name] = sent, was_heard

    def note_found(self, tool: str, html: str) -> None:
        """Show what a tool that sends nothing found last, as HTML."""
        self._found[tool] = html

    def take_cleared(self) -> list[str]:
        """The tools of which browsers asked since the last call to remove what they found."""
        return [self._cleared.popleft() for _ in range(len(self._cleared))]

    def take(self) -> list[Aim]:
        """The uses of tools since the last call, the oldest first."""
        return [self._aims.popleft() for _ in range(len(self._aims))]

    def _take(self, event: Mapping[str, Any]) -> None:
        tool = str(event.get("tool"))
        start, end = _place(event.get("from")), _place(event.get("to"))
        client = event["client"]
        is_known = tool in self._tools or tool in FINDERS
        if is_known and start is not None and end is not None and client is not None:
            self._aims.append(Aim(client, tool, start, end, event.get("step", 1) == 1))

    def _clear(self, event: Mapping[str, Any]) -> None:
        tool = str(event.get("tool"))
        if tool in self._found:
            self._found[tool] = ""
            self._cleared.append(tool)


def sent_text(topic: str, frame_id: str, xyz: tuple[float, float, float], yaw_rad: float) -> str:
    """A line about a message that was sent."""
    x, y, z = xyz
    turn = f", {math.degrees(yaw_rad):.0f}°" if yaw_rad else ""
    height = f", {z:.2f}" if abs(z) >= 0.005 else ""
    return f"{printable(topic)}: {x:.2f}, {y:.2f}{height}{turn} in {printable(frame_id)}"


def measured_text(
    frame_id: str, start: tuple[float, float, float], end: tuple[float, float, float]
) -> str:
    """The distance of two points of a frame, and their difference along its axes."""
    # Not -0.000.
    x, y, z = (round(b - a, 3) + 0.0 for a, b in zip(start, end, strict=True))
    far_m = math.dist(start, end)
    return f"{far_m:.3f} m: x {x:.3f}, y {y:.3f}, z {z:.3f} in {printable(frame_id)}"


def picked_html(point: PickedPoint) -> str:
    """A selected point: its index, its places by frame, and its columns."""
    facts = {f"in {frame}": place_text(xyz) for frame, xyz in point.places.items()}
    rows = "".join(
        f"<dt>{escape(printable(name, 60))}</dt><dd>{escape(value)}</dd>"
        for name, value in (facts | dict(point.columns)).items()
    )
    title = f"{escape(printable(point.topic))}: point {point.index}"
    return f'<b>{title}</b><dl class="tf-facts">{rows}</dl>'


def place_text(xyz: tuple[float, float, float]) -> str:
    """The coordinates of a point, to the millimetre."""
    # Not -0.000.
    return ", ".join(f"{round(part, 3) + 0.0:.3f}" for part in xyz)


def _found_html(tool: str, found: str) -> str:
    if not found:
        return ""
    remove = event("unfind", tool=f"'{tool}'")
    return (
        f'<div class="tf" role="log" aria-label="{FINDERS[tool].done}">{found} '
        f'<button class="tf-link" onclick="{remove}">remove</button></div>'
    )


def _setter(view: ViewState, name: str) -> Callable[[str], None]:
    return lambda value: view.change(**{name: value.strip()})


def _place(value: object) -> Place | None:
    if not isinstance(value, list) or len(value) != 2:
        return None
    x, y = value
    if not all(isinstance(part, int | float) and 0.0 <= part <= 1.0 for part in (x, y)):
        return None
    return float(x), float(y)


def _buttons(tools: Mapping[str, Tool]) -> str:
    buttons = "".join(_button(tool.name, tool.title, tool.key) for tool in tools.values())
    buttons += "".join(_button(name, each.title, each.key) for name, each in FINDERS.items())
    sends = "Drag on the ground for a pose, click for a point, twice" if tools else "Click twice"
    return (
        f'<div class="tf"><div class="tf-tools">{buttons}</div><div class="tf-dim">{sends} to '
        "measure, on a point of a cloud to select it; Escape puts a tool away.</div></div>"
    )


def _button(name: str, title: str, key: str) -> str:
    return (
        f'<button data-tool="{name}" aria-pressed="false" onclick="tfbusTool(\'{name}\')">'
        f"{title} ({key})</button>"
    )


def script(*, sends: bool) -> str:
    """The page's script, with the tools that send or without them."""
    tools = {
        tool.name: {"key": tool.key.lower(), "clicks": 1, "heading": tool.has_heading}
        for tool in (TOOLS.values() if sends else ())
    }
    tools |= {
        name: {"key": each.key.lower(), "clicks": each.clicks, "heading": False}
        for name, each in FINDERS.items()
    }
    return f"window.tfbusTools = {json.dumps(tools)};{_SCRIPT}"


STYLE = """
.tf-tools { display: flex; flex-wrap: wrap; gap: 4px; margin: 0.5em 0; }
.tf-tools button { all: unset; cursor: pointer; flex: 1 0 40%; text-align: center;
  padding: 0.45em 0; border-radius: 4px; background: light-dark(#e7f1fb, #1c3a57); }
.tf-tools button:hover { background: light-dark(#d0e4f7, #27507a); }
.tf-tools button[aria-pressed=true] { background: #228be6; color: white; }
.tf-tools button:focus-visible { outline: 2px solid #228be6; }
.tf-aim { position: absolute; inset: 0; cursor: crosshair; touch-action: none; }
.tf-aim svg { width: 100%; height: 100%; pointer-events: none; }
body:has(.tf-aim) .mantine-Notification-root { pointer-events: none !important; }
"""

# The overlay lies on the canvas, so that the camera stays where it is; the arrow on it is the
# browser's own, and waits for no link. Keys work always, but the buttons come with their tab.
_SCRIPT = """
window.tfbusTool = (name) => {
  const same = window.tfbusAim === name;
  window.tfbusAimStop?.();
  const tool = window.tfbusTools[name];
  const canvas = [...document.querySelectorAll('canvas')]
    .sort((a, b) => b.clientWidth * b.clientHeight - a.clientWidth * a.clientHeight)[0];
  if (same || !canvas) return;
  const cover = document.createElement('div');
  cover.className = 'tf-aim';
  cover.innerHTML = '<svg><defs><marker id="tf-tip" markerWidth="4" markerHeight="4" refX="2" '
    + 'refY="2" orient="auto"><path d="M0,0 L4,2 L0,4 z" fill="#228be6"/></marker></defs>'
    + '<line stroke="#228be6" stroke-width="4" marker-end="url(#tf-tip)" visibility="hidden"/>'
    + '</svg>';
  const line = cover.querySelector('line');
  let from = null;
  let clicks = 0;
  const at = (event) => {
    const box = canvas.getBoundingClientRect();
    return [[event.clientX - box.left, event.clientY - box.top],
      [(event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height]];
  };
  const key = (event) => { if (event.key === 'Escape') stop(); };
  const press = (pressed) => document.querySelector(`[data-tool=${name}]`)
    ?.setAttribute('aria-pressed', pressed);
  const comes = new MutationObserver(() => press(true));
  const stop = () => {
    window.tfbusAim = window.tfbusAimStop = null;
    cover.remove();
    comes.disconnect();
    document.removeEventListener('keydown', key);
    press(false);
  };
  cover.onpointerdown = (event) => {
    if (event.button) return;
    cover.setPointerCapture(event.pointerId);
    from = at(event);
  };
  cover.onpointermove = (event) => {
    if (!from || !(tool.heading || clicks)) return;
    const [[x, y]] = at(event);
    const ends = {x1: from[0][0], y1: from[0][1], x2: x, y2: y, visibility: 'visible'};
    Object.entries(ends).forEach(([name, value]) => line.setAttribute(name, value));
  };
  cover.onpointerup = (event) => {
    if (!from) return;
    clicks += 1;
    tfbus({do: 'tool', tool: name, from: from[1], to: at(event)[1], step: clicks});
    if (clicks === tool.clicks) stop();
  };
  cover.onpointercancel = stop;
  cover.oncontextmenu = (event) => { event.preventDefault(); stop(); };
  document.addEventListener('keydown', key);
  press(true);
  comes.observe(document.body, {childList: true, subtree: true});
  canvas.parentElement.append(cover);
  window.tfbusAim = name;
  window.tfbusAimStop = stop;
};
if (!window.tfbusToolKeys) {
  window.tfbusToolKeys = true;
  document.addEventListener('keydown', (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || event.repeat) return;
    if (event.target.closest('input, textarea, [contenteditable], .tf-keys')) return;
    const found = Object.entries(window.tfbusTools)
      .find(([, tool]) => tool.key === event.key.toLowerCase());
    if (found) tfbusTool(found[0]);
  });
}
"""
