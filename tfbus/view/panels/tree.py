"""The tree of frames, one row each with its box and badge, and the facts of the selected one."""

from html import escape

import viser

from tfbus.buffer.buffer import Buffer
from tfbus.view.model.filter import NameFilter
from tfbus.view.model.placement import Placed
from tfbus.view.model.settings import ViewSettings
from tfbus.view.model.shown_frames import Frames, ViewFrame
from tfbus.view.model.view_state import ViewState
from tfbus.view.panels import text
from tfbus.view.panels.frame_dropdown import FrameDropdown
from tfbus.view.panels.markup import Channel, Html, event, sign
from tfbus.wording import and_more

# More rows are slow to show; the filter narrows them.
MOST_ROWS = 150

# A rate is rewritten only after a change by this part: rows that change width jump.
_RATE_TOLERANCE = 0.15


class TreePanel:
    """The fixed frame, the tree, and the facts of the selected frame."""

    def __init__(self, gui: viser.GuiApi, view: ViewState, channel: Channel) -> None:
        self._view = view
        self._rates: dict[str, float] = {}
        self._listed: tuple[str, ...] = ()
        self._fixed = FrameDropdown(
            gui,
            "Fixed frame",
            "automatic",
            lambda name: view.change(fixed_frame=name),
            hint="The frame that everything is seen from.",
        )
        self._tree = Html(gui.add_html(""))
        self._actions = Html(gui.add_html(""))
        self._facts = Html(gui.add_html(""))
        channel.on("select", lambda e: view.change(selected=str(e.get("frame", ""))))
        channel.on("show", lambda e: view.tick("hidden", str(e.get("frame", "")), not e.get("on")))
        channel.on(
            "trail", lambda e: view.tick("trails", str(e.get("frame", "")), bool(e.get("on")))
        )
        channel.on("show all", lambda e: view.change(hidden=()))
        channel.on("hide all", lambda e: view.change(hidden=self._listed))
        channel.on("fix", lambda e: view.change(fixed_frame=str(e.get("frame", ""))))

    def refresh(
        self, frames: Frames, placed: Placed, fixed_frame: str, buffer: Buffer, now_ns: int
    ) -> None:
        """Show these frames."""
        settings = self._view.settings
        natural = frames.natural_fixed_frame()
        automatic = f"automatic ({natural})" if natural else "automatic"
        self._fixed.show(sorted(frames.by_name), settings.fixed_frame, automatic)
        self._tree.show(self._rows(frames, placed, settings))
        selected = frames.by_name.get(settings.selected)
        if selected is None:
            self._actions.show("")
            self._facts.show(_nothing_selected(settings.selected) if len(frames) else "")
            return
        self._actions.show(_actions(selected, settings))
        stamp_ns = self._view.playback.stamp_ns
        self._facts.show(_details(selected, placed, fixed_frame, buffer, stamp_ns, now_ns))

    def _rows(self, frames: Frames, placed: Placed, settings: ViewSettings) -> str:
        names = settings.filter
        taken = [frame for frame in frames if names.takes(frame.name)]
        self._listed = tuple(frame.name for frame in taken)
        rows = [_ALL_OR_NONE] if len(frames) else []
        for frame in taken[:MOST_ROWS]:
            rows.append(self._row(frame, settings))
            why = frame.unplaced if frame.depth == 0 else placed.missing.get(frame.name, "")
            if why:
                rows.append(f'<div class="tf-why tf-alarm">{escape(why)}</div>')
        if more := and_more(len(taken), MOST_ROWS):
            rows.append(
                f'<div class="tf-dim">{more}: narrow them with <i>Only</i> in the tab View</div>'
            )
        if len(taken) < len(frames):
            rows.append(_filtered(len(frames) - len(taken), names))
        return f'<div class="tf" role="tree">{"".join(rows)}</div>'

    def _row(self, frame: ViewFrame, settings: ViewSettings) -> str:
        name = escape(frame.name)
        box = event("show", frame="this.dataset.frame", on="this.checked")
        select = event("select", frame="this.dataset.frame")
        checked = "" if frame.name in settings.hidden else "checked"
        selected = " tf-selected" if frame.name == settings.selected else ""
        dim = " tf-dim" if frame.unplaced else ""
        return (
            f'<div class="tf-row{selected}" role="treeitem" data-status="{frame.state}" '
            f'data-row="{name}">'
            f'<input type="checkbox" {checked} aria-label="show {name}" data-frame="{name}" '
            f'onclick="{box}">'
            f"{sign(frame.state)}"
            f'<button class="{dim}" style="padding-left:{0.8 * frame.depth:g}em" title="{name}" '
            f'data-frame="{name}" onpointerdown="{select}" onclick="{select}">{name}</button>'
            f'<span class="tf-note">{self._note(frame)}</span></div>'
        )

    def _note(self, frame: ViewFrame) -> str:
        if frame.state == "conflict":
            return f"{len(frame.publishers)} publishers"
        if frame.state != "dynamic":
            return frame.state
        rate_hz = frame.info.rate_hz
        if rate_hz is None:
            return ""
        written = self._rates.get(frame.name, 0.0)
        if abs(rate_hz - written) > _RATE_TOLERANCE * written:
            self._rates[frame.name] = rate_hz
        return text.rate_text(self._rates[frame.name])


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
    return f'<div class="tf-dim">{count} hidden by {patterns}</div>'


def _nothing_selected(name: str) -> str:
    if name:
        return f'<div class="tf tf-dim">Selected: {escape(name)}, which does not exist.</div>'
    return '<div class="tf tf-dim">Click on a frame to see its publisher, rate and pose.</div>'


def _actions(frame: ViewFrame, settings: ViewSettings) -> str:
    name = escape(frame.name)
    checked = "checked" if frame.name in settings.trails else ""
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
    frame: ViewFrame,
    placed: Placed,
    fixed_frame: str,
    buffer: Buffer,
    stamp_ns: int | None,
    now_ns: int,
) -> str:
    parts = [text.facts(frame, now_ns)]
    why = frame.unplaced or placed.missing.get(frame.name, "")
    if why:
        parts.append(f'<div class="tf-alarm">Not shown: {escape(why)}</div>')
    if frame.info.parent is not None:
        pose = text.pose_in(buffer, frame.info.parent, frame.name, stamp_ns)
        parts.append(text.numbers(f"in its parent {frame.info.parent}", "tf-in-parent", pose))
    if fixed_frame not in ("", frame.info.parent) and not why:
        pose = text.pose_in(buffer, fixed_frame, frame.name, stamp_ns)
        parts.append(text.numbers(f"in {fixed_frame}", "tf-in-fixed", pose))
    return f'<div class="tf">{"".join(parts)}</div>'
