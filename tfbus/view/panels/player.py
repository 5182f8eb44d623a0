"""The bar below the scene that plays a recording: buttons, speed, a timeline with marks, keys."""

import json
import math
from collections import Counter
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from html import escape
from importlib.resources import files
from typing import Any

import viser

from tfbus.recording.playhead import nearest_rate
from tfbus.view.panels.markup import FIRST_DATE_NS, Channel, Html
from tfbus.view.replay import Replay
from tfbus.view.timeline import KINDS, MarkKind, Timeline

_LABELS: dict[MarkKind, str] = {
    "gone": "gone",
    "back": "back",
    "restart": "restarted",
    "conflict": "conflict",
    "gap": "silent",
    "paused": "not recorded",
    "dropped": "dropped",
}

# A timeline has no room for more, and a browser that draws them is slow.
_MOST_MARKS = 1000

# The speeds to choose from; a program may set any.
SPEEDS = (0.1, 0.25, 0.5, 1.0, 2.0, 5.0, 10.0)

_markup = files("tfbus.view.panels")

# How far the keys J and L jump.
_JUMP_S = 5.0


class PlayerBar:
    """Moves the playhead of a recording as browsers ask, and shows them where it is."""

    @staticmethod
    def style() -> str:
        """The bar's CSS."""
        return _markup.joinpath("player.css").read_text("utf-8")

    @staticmethod
    def script() -> str:
        """The bar's JavaScript: it makes the bar, and keeps it below the scene."""
        return _markup.joinpath("player.js").read_text("utf-8")

    def __init__(self, gui: viser.GuiApi, channel: Channel, replay: Replay) -> None:
        self._replay = replay
        self._playhead = replay.playhead
        self._timeline: Timeline | None = None
        self._line = Html(gui.add_html(""))
        self._cursor = Html(gui.add_html(""))
        for do, take in (
            ("play", self._on_play),
            ("seek", self._on_seek),
            ("step", self._on_step),
            ("speed", self._on_speed),
            ("faster", self._on_faster),
            ("loop", self._on_loop),
        ):
            channel.on(do, take)
        self._add_keys(gui)

    def refresh(self) -> None:
        """Show the timeline, and where the playhead is."""
        timeline = self._replay.timeline
        if timeline is not self._timeline:
            self._timeline = timeline
            self._line.show(_call("tfbusTimeline", _line(timeline)))
        jumps, progress = self._playhead.jumps, self._playhead.progress
        state = {
            "at": (progress.log_ns - timeline.start_ns) / 1e9,
            "plays": not progress.is_paused,
            "speed": progress.rate,
            "loops": progress.loops > 0,
            "jumps": jumps,
        }
        self._cursor.show(_call("tfbusCursor", state))

    # Requests of browsers; numbers are checked, since any program may send an event

    def _on_play(self, event: Mapping[str, Any]) -> None:
        if event.get("plays") is True:
            self._playhead.resume()
        else:
            self._playhead.pause()

    def _on_seek(self, event: Mapping[str, Any]) -> None:
        at_s = _number(event.get("s"))
        if at_s is None:
            return
        plays = event.get("plays")
        at_ns = self._playhead.start_ns + round(at_s * 1e9)
        self._playhead.seek(at_ns, paused=not plays if isinstance(plays, bool) else None)

    def _on_step(self, event: Mapping[str, Any]) -> None:
        self._playhead.step(-1 if event.get("by") == -1 else 1)

    def _on_speed(self, event: Mapping[str, Any]) -> None:
        if (speed := _number(event.get("speed"))) is not None:
            self._playhead.set_rate(nearest_rate(speed))

    def _on_faster(self, event: Mapping[str, Any]) -> None:
        speed = self._playhead.progress.rate
        if event.get("by") == -1:
            speed = max((each for each in SPEEDS if each < speed), default=speed)
        else:
            speed = min((each for each in SPEEDS if each > speed), default=speed)
        self._playhead.set_rate(speed)

    def _on_loop(self, event: Mapping[str, Any]) -> None:
        self._playhead.loop(event.get("loops") is True)

    def _add_keys(self, gui: viser.GuiApi) -> None:
        playhead = self._playhead
        commands: tuple[tuple[str, Any, Callable[[], object]], ...] = (
            ("Play or pause", "space", playhead.toggle_paused),
            (f"{_JUMP_S:g} s back", "J", lambda: playhead.seek_by(-_JUMP_S)),
            (f"{_JUMP_S:g} s forward", "L", lambda: playhead.seek_by(_JUMP_S)),
            ("To the event before", "P", lambda: self._to_mark(-1)),
            ("To the next event", "N", lambda: self._to_mark(1)),
            ("To the beginning", "home", lambda: playhead.seek(playhead.start_ns)),
            ("To the end", "end", lambda: playhead.seek(playhead.end_ns)),
        )
        for label, key, action in commands:
            gui.add_command(label, hotkey=key).on_trigger(_without_event(action))

    def _to_mark(self, by: int) -> None:
        if self._timeline is None:
            return
        at_ns = self._playhead.progress.log_ns
        mark = self._timeline.next_mark(at_ns) if by > 0 else self._timeline.mark_before(at_ns)
        if mark is not None:
            self._playhead.seek(mark.start_ns)


def _without_event(action: Callable[[], object]) -> Callable[[Any], None]:
    def on_trigger(event: Any) -> None:
        action()

    return on_trigger


def _number(value: Any) -> float | None:
    """A number of seconds that a browser sent, if 64 bits can hold its nanoseconds; else None."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    return float(value) if abs(value) < 9e9 else None


def _line(timeline: Timeline) -> dict[str, Any]:
    start_ns = timeline.start_ns
    # Of too many every second, or third, so that none of the parts of the timeline lacks them.
    shown = timeline.marks[:: math.ceil(len(timeline.marks) / _MOST_MARKS) or 1]
    counts = Counter(mark.kind for mark in timeline.marks)
    has_dates = start_ns >= FIRST_DATE_NS
    return {
        "id": f"{id(timeline)}",
        "start_ms": start_ns // 1_000_000 if has_dates else None,
        "zone_ms": _zone_ms(start_ns) if has_dates else 0,
        "span": timeline.span_s,
        "speeds": SPEEDS,
        "kinds": [(kind, _LABELS[kind], counts[kind]) for kind in KINDS if counts[kind]],
        "marks": [
            (mark.kind, _since(start_ns, mark.start_ns), _since(start_ns, mark.end_ns), mark.text)
            for mark in shown
        ],
        "more": len(timeline.marks) - len(shown),
        "activity": timeline.activity,
    }


def _since(start_ns: int, at_ns: int) -> float:
    return max(at_ns - start_ns, 0) / 1e9


def _zone_ms(at_ns: int) -> int:
    """How far the local time of this machine is ahead of UTC."""
    offset = datetime.fromtimestamp(at_ns // 1_000_000_000, UTC).astimezone().utcoffset()
    return round(offset.total_seconds() * 1e3) if offset else 0


def _call(function: str, value: Any) -> str:
    """HTML that calls a function of the page's script, in each browser that gets it."""
    given = json.dumps(value)
    call = (
        f"window.{function} ? {function}({given}) : "
        f"(window.tfbusEarly = window.tfbusEarly || []).push(['{function}', {given}])"
    )
    return (
        '<div class="tfbus-player-state">'
        f'<img hidden alt="" src="data:," onerror="{escape(call)}"></div>'
    )
