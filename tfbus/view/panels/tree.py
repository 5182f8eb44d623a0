"""The tree of frames, a row each with its box and badge, and all about the one selected."""

from html import escape

import viser

from tfbus import Buffer
from tfbus.view.model.filter import NameFilter
from tfbus.view.model.frames import Frames
from tfbus.view.model.placement import Placed
from tfbus.view.model.settings import ViewSettings
from tfbus.view.model.status import FrameState, Status
from tfbus.view.model.view_state import Desk
from tfbus.view.panels import text
from tfbus.view.panels.frame_dropdown import FrameChoice
from tfbus.view.panels.markup import Channel, Html, event, sign

# More rows than these are slow to show; the filter narrows them.
MOST_ROWS = 150

# A rate is written anew where it has changed by this part: rows that change are rows that jump.
_RATE_TOLERANCE = 0.15


class TreePanel:
    """The fixed frame, the tree, and the selected frame."""

    def __init__(self, gui: viser.GuiApi, desk: Desk, channel: Channel) -> None:
        self._desk = desk
        self._rates: dict[str, float] = {}
        self._listed: tuple[str, ...] = ()
        self._fixed = FrameChoice(
            gui,
            "Fixed frame",
            "automatic",
            lambda name: desk.change(fixed_frame=name),
            hint="Everything is seen from here.",
        )
        self._tree = Html(gui.add_html(""))
        self._actions = Html(gui.add_html(""))
        self._facts = Html(gui.add_html(""))
        channel.on("select", lambda e: desk.change(selected=str(e.get("frame", ""))))
        channel.on("show", lambda e: desk.tick("hidden", str(e.get("frame", "")), not e.get("on")))
        channel.on(
            "trail", lambda e: desk.tick("trails", str(e.get("frame", "")), bool(e.get("on")))
        )
        channel.on("show all", lambda e: desk.change(hidden=()))
        channel.on("hide all", lambda e: desk.change(hidden=self._listed))
        channel.on("fix", lambda e: desk.change(fixed_frame=str(e.get("frame", ""))))

    def refresh(
        self, frames: Frames, placed: Placed, fixed_frame: str, buffer: Buffer, now_ns: int
    ) -> None:
        """Show these frames."""
        settings = self._desk.settings
        natural = frames.natural_fixed_frame()
        automatic = f"automatic ({natural})" if natural else "automatic"
        self._fixed.show(sorted(frames.states), settings.fixed_frame, automatic)
        self._tree.show(self._rows(frames, placed, settings))
        selected = frames.get(settings.selected)
        if selected is None:
            self._actions.show("")
            self._facts.show(_nothing_selected(settings.selected) if len(frames) else "")
            return
        self._actions.show(_actions(selected, settings))
        stamp_ns = self._desk.playback.stamp_ns
        self._facts.show(_details(selected, placed, fixed_frame, buffer, stamp_ns, now_ns))

    def _rows(self, frames: Frames, placed: Placed, settings: ViewSettings) -> str:
        names = settings.filter
        taken = [state for state in frames if names.takes(state.name)]
        self._listed = tuple(state.name for state in taken)
        rows = [_ALL_OR_NONE] if len(frames) else []
        for state in taken[:MOST_ROWS]:
            rows.append(self._row(state, settings))
            why = state.unplaced if state.depth == 0 else placed.missing.get(state.name, "")
            if why:
                rows.append(f'<div class="tf-why tf-alarm">{escape(why)}</div>')
        if len(taken) > MOST_ROWS:
            rows.append(
                f'<div class="tf-dim">and {len(taken) - MOST_ROWS} more: narrow them by '
                "<i>Only</i> in the tab View</div>"
            )
        if len(taken) < len(frames):
            rows.append(_filtered(len(frames) - len(taken), names))
        return f'<div class="tf" role="tree">{"".join(rows)}</div>'

    def _row(self, state: FrameState, settings: ViewSettings) -> str:
        name = escape(state.name)
        box = event("show", frame="this.dataset.frame", on="this.checked")
        select = event("select", frame="this.dataset.frame")
        checked = "" if state.name in settings.hidden else "checked"
        selected = " tf-selected" if state.name == settings.selected else ""
        dim = " tf-dim" if state.unplaced else ""
        return (
            f'<div class="tf-row{selected}" role="treeitem" data-status="{state.status.value}" '
            f'data-row="{name}">'
            f'<input type="checkbox" {checked} aria-label="show {name}" data-frame="{name}" '
            f'onclick="{box}">'
            f"{sign(state.status)}"
            f'<button class="{dim}" style="padding-left:{0.8 * state.depth:g}em" title="{name}" '
            f'data-frame="{name}" onpointerdown="{select}" onclick="{select}">{name}</button>'
            f'<span class="tf-note">{self._note(state)}</span></div>'
        )

    def _note(self, state: FrameState) -> str:
        if state.status is not Status.FRESH:
            count = len(state.publishers)
            return f"{count} publishers" if state.status is Status.CONFLICT else state.status.value
        rate_hz = state.info.rate_hz
        if rate_hz is None:
            return ""
        written = self._rates.get(state.name, 0.0)
        if abs(rate_hz - written) > _RATE_TOLERANCE * written:
            self._rates[state.name] = rate_hz
        return text.rate_text(self._rates[state.name])


_ALL_OR_NONE = (
    '<div class="tf-row tf-dim">Show '
    f'<a class="tf-link" role="button" tabindex="0" onclick="{event("show all")}">all</a>'
    f'<a class="tf-link" role="button" tabindex="0" onclick="{event("hide all")}">none</a></div>'
)


def _filtered(count: int, names: NameFilter) -> str:
    patterns = " and ".join(
        f"{word} {escape(repr(pattern))}"
        for word, pattern in (("Only", names.only), ("Never", names.never))
        if pattern
    )
    return f'<div class="tf-dim">{count} left out by {patterns}</div>'


def _nothing_selected(name: str) -> str:
    if name:
        return f'<div class="tf tf-dim">Selected: {escape(name)}, which is not there.</div>'
    return '<div class="tf tf-dim">Click on a frame to see its publisher, rate and pose.</div>'


def _actions(state: FrameState, settings: ViewSettings) -> str:
    name = escape(state.name)
    checked = "checked" if state.name in settings.trails else ""
    trail = event("trail", frame="this.dataset.frame", on="this.checked")
    fix = event("fix", frame="this.dataset.frame")
    return (
        f'<div class="tf"><div class="tf-title"><b>{name}</b>'
        f'<label><input type="checkbox" {checked} aria-label="trail of {name}" '
        f'data-frame="{name}" onclick="{trail}"> trail</label>'
        f'<a class="tf-link" role="button" tabindex="0" data-frame="{name}" onclick="{fix}">'
        "see from here</a></div></div>"
    )


def _details(
    state: FrameState,
    placed: Placed,
    fixed_frame: str,
    buffer: Buffer,
    stamp_ns: int | None,
    now_ns: int,
) -> str:
    parts = [text.facts(state, now_ns)]
    why = state.unplaced or placed.missing.get(state.name, "")
    if why:
        parts.append(f'<div class="tf-alarm">Not shown: {escape(why)}</div>')
    if state.info.parent is not None:
        pose = text.pose_in(buffer, state.info.parent, state.name, stamp_ns)
        parts.append(text.numbers(f"in its parent {state.info.parent}", "tf-in-parent", pose))
    if fixed_frame not in ("", state.info.parent) and not why:
        pose = text.pose_in(buffer, fixed_frame, state.name, stamp_ns)
        parts.append(text.numbers(f"in {fixed_frame}", "tf-in-fixed", pose))
    return f'<div class="tf">{"".join(parts)}</div>'
