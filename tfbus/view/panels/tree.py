"""The tree of frames, one row each with its box and badge, and the facts of the selected one."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from html import escape

import viser

from tfbus.buffer.buffer import Buffer
from tfbus.view.model.frames import Frames, Placed, ViewFrame
from tfbus.view.model.settings import NameFilter, Selections, ViewSettings, ViewState
from tfbus.view.panels import text
from tfbus.view.panels.controls import FrameDropdown
from tfbus.view.panels.markup import Channel, Html, event, sign, unless_it_left
from tfbus.wording import and_more

# More rows are slow to show; the filter narrows them.
MOST_ROWS = 150

# A rate is rewritten only after a change by this part: rows that change width jump.
_RATE_TOLERANCE = 0.15


@dataclass(frozen=True)
class _Browser:
    """The tree as one browser sees it: with the frame that it has selected."""

    tree: Html
    actions: Html
    facts: Html


class TreePanel:
    """The fixed frame, the tree, and the facts of the frame that each browser has selected."""

    def __init__(
        self,
        server: viser.ViserServer,
        tab: viser.GuiTabHandle,
        view: ViewState,
        selections: Selections,
        channel: Channel,
    ) -> None:
        self._server = server
        self._tab = tab
        self._view = view
        self._selections = selections
        self._browsers: dict[int, _Browser] = {}
        self._rates: dict[str, float] = {}
        self._listed: tuple[str, ...] = ()
        self._fixed = FrameDropdown(
            server.gui,
            "Fixed frame",
            "automatic",
            lambda name: view.change(fixed_frame=name),
            hint="The frame that everything is seen from.",
        )
        channel.on("select", lambda e: selections.select(e["client"], str(e.get("frame", ""))))
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
        self._fixed.offer(sorted(frames.by_name), settings.fixed_frame, automatic)
        rows = self._rows(frames, placed, settings)
        self._meet()
        stamp_ns = self._view.playback.stamp_ns
        for number, browser in self._browsers.items():
            name = self._selections.of(number)
            selected = frames.by_name.get(name)
            if selected is None:
                actions, facts = "", _nothing_selected(name) if len(frames) else ""
            else:
                actions = _actions(selected, settings)
                facts = _details(selected, placed, fixed_frame, buffer, stamp_ns, now_ns)
            with unless_it_left(self._server, number):
                tree = "".join(_marked(rows, name))
                browser.tree.show(f'<div class="tf" role="tree">{tree}</div>')
                browser.actions.show(actions)
                browser.facts.show(facts)

    def _meet(self) -> None:
        """Add the elements of new browsers, and forget those of browsers that have left."""
        clients = self._server.get_clients()
        self._browsers = {
            number: self._browsers.get(number) or self._add(client)
            for number, client in clients.items()
        }

    def _add(self, client: viser.ClientHandle) -> _Browser:
        def html(place: int) -> Html:
            # Right below the fixed frame, whatever comes further down.
            return Html(client.gui.add_html("", order=self._fixed.order + 0.1 * place))

        with self._tab:
            return _Browser(html(1), html(2), html(3))

    def _rows(self, frames: Frames, placed: Placed, settings: ViewSettings) -> dict[str, str]:
        """The rows, by their frames; other lines have keys that no frame can have."""
        names = settings.filter
        taken = [frame for frame in frames if names.takes(frame.name)]
        self._listed = tuple(frame.name for frame in taken)
        rows = {"/head": _ALL_OR_NONE} if len(frames) else {}
        for frame in taken[:MOST_ROWS]:
            rows[frame.name] = self._row(frame, settings)
            why = frame.unplaced if frame.depth == 0 else placed.missing.get(frame.name, "")
            if why:
                rows[f"/why/{frame.name}"] = f'<div class="tf-why tf-alarm">{escape(why)}</div>'
        if more := and_more(len(taken), MOST_ROWS):
            rows["/more"] = (
                f'<div class="tf-dim">{more}: narrow them with <i>Only</i> in the tab View</div>'
            )
        if len(taken) < len(frames):
            rows["/filtered"] = _filtered(len(frames) - len(taken), names)
        return rows

    def _row(self, frame: ViewFrame, settings: ViewSettings) -> str:
        name = escape(frame.name)
        box = event("show", frame="this.dataset.frame", on="this.checked")
        select = event("select", frame="this.dataset.frame")
        checked = "" if frame.name in settings.hidden else "checked"
        dim = " tf-dim" if frame.unplaced else ""
        return (
            f'{_ROW} role="treeitem" data-status="{frame.state}" '
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


# The tree has the height down to the end of the page while no frame is selected, and else the
# height that the facts below it leave: a row that is selected stays in sight, wherever it was.
SCRIPT = """
new MutationObserver(() => {
  const row = document.querySelector('.tf[role=tree] .tf-selected');
  const name = row ? row.dataset.row : '';
  if (name !== window.tfbusSelected) row?.scrollIntoView({block: 'nearest'});
  window.tfbusSelected = name;
}).observe(document.body, {childList: true, subtree: true});
"""

# How a row begins, and how the selected one does.
_ROW = '<div class="tf-row"'
_SELECTED_ROW = '<div class="tf-row tf-selected" aria-selected="true"'


def _marked(rows: Mapping[str, str], name: str) -> Iterable[str]:
    """The rows, that of one frame marked as selected."""
    row = rows.get(name)
    if row is None:
        return rows.values()
    return {**rows, name: row.replace(_ROW, _SELECTED_ROW, 1)}.values()


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
