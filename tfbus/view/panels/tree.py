"""Frames on the panel: their tree, the facts of the selected one, and how far two are apart."""

import math
import shlex
from collections.abc import Iterable, Mapping, Sequence
from html import escape

import viser

from tfbus.base.errors import TransformException
from tfbus.base.wording import and_more, duration, listed
from tfbus.buffer.buffer import Buffer
from tfbus.frames.document import Numbers, tf2_block
from tfbus.geometry.transform import TransformStamped
from tfbus.view.frames import Frames, Placed, ViewFrame
from tfbus.view.panels.controls import FrameDropdown
from tfbus.view.panels.markup import Channel, Html, clock_time, event, sign, unless_it_left
from tfbus.view.settings import NameFilter, Selections, ViewSettings, ViewState

# More rows are slow to show; the filter narrows them.
MOST_ROWS = 150

# A rate is rewritten only after a change by this part: rows that change width jump.
_RATE_TOLERANCE = 0.15


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
        self._browsers: dict[int, list[Html]] = {}
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
        channel.on("follow", lambda e: view.change(follow=str(e.get("frame", ""))))
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
        stamp_ns = self._view.playback.stamp_ns
        clients = self._server.get_clients()
        known, self._browsers = self._browsers, {}
        for number, client in clients.items():
            name = self._selections.of(number)
            selected = frames.by_name.get(name)
            tree = f'<div class="tf" role="tree">{"".join(_marked(rows, name))}</div>'
            if selected is None:
                shown = (tree, "", _nothing_selected(name) if len(frames) else "")
            else:
                facts = _details(selected, placed, fixed_frame, buffer, stamp_ns, now_ns)
                shown = (tree, _actions(selected, settings), facts)
            with unless_it_left(self._server, number):
                self._browsers[number] = known.get(number) or self._add(client, shown)
                for element, content in zip(self._browsers[number], shown, strict=True):
                    element.show(content)

    def _add(self, client: viser.ClientHandle, shown: Sequence[str]) -> list[Html]:
        """The elements of a browser: the tree, and the actions and facts of the frame that is
        selected there. With their content at once: a busy browser may mistake the order of
        messages, and loses changes of elements that it does not have yet.
        """
        with self._tab:
            # Right below the fixed frame, whatever comes further down.
            return [
                Html(client.gui.add_html(content, order=self._fixed.order + 0.1 * place))
                for place, content in enumerate(shown, start=1)
            ]

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
        return rate_text(self._rates[frame.name])


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
    """The rows, one frame's marked as selected."""
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
    follow, is_followed = event("follow", frame="this.dataset.frame"), settings.follow == frame.name
    return (
        f'<div class="tf"><div class="tf-title"><b>{name}</b>'
        f'<label><input type="checkbox" {checked} aria-label="trail of {name}" '
        f'data-frame="{name}" onclick="{trail}"> trail</label>'
        f'<a class="tf-link" role="button" tabindex="0" data-frame="{name}" onclick="{fix}">'
        'see from here</a><a class="tf-link" role="button" tabindex="0" '
        f'data-frame="{"" if is_followed else name}" onclick="{follow}">'
        f"{'stop following' if is_followed else 'follow'}</a></div></div>"
    )


def _details(
    frame: ViewFrame,
    placed: Placed,
    fixed_frame: str,
    buffer: Buffer,
    stamp_ns: int | None,
    now_ns: int,
) -> str:
    parts = [facts_of(frame, now_ns)]
    why = frame.unplaced or placed.missing.get(frame.name, "")
    if why:
        parts.append(f'<div class="tf-alarm">Not shown: {escape(why)}</div>')
    if frame.info.parent is not None:
        pose = pose_in(buffer, frame.info.parent, frame.name, stamp_ns)
        parts.append(numbers(f"in its parent {frame.info.parent}", "tf-in-parent", pose))
    if fixed_frame not in ("", frame.info.parent) and not why:
        pose = pose_in(buffer, fixed_frame, frame.name, stamp_ns)
        parts.append(numbers(f"in {fixed_frame}", "tf-in-fixed", pose))
    return f'<div class="tf">{"".join(parts)}</div>'


# Facts and numbers of frames, as HTML.

_MOST_CHILDREN = 20

_DIGITS = Numbers(precision=3)


def facts_of(frame: ViewFrame, now_ns: int) -> str:
    """The publisher of a frame, its rate and its age."""
    info = frame.info
    rows = [("State", f"{sign(frame.state)} {escape(explained(frame))}")]
    if info.parent is not None:
        rows.append(("Parent", escape(info.parent)))
        rows.append(("Publisher", escape(", ".join(frame.publishers) or "unnamed")))
        rows.append(("Rate", "static" if info.static else rate_text(info.rate_hz)))
    if info.newest_ns is not None and not info.static:
        rows.append(("Age", duration((now_ns - info.newest_ns) / 1e9)))
        rows.append(("Newest", clock_time(info.newest_ns, now_ns)))
    if info.children:
        rows.append(("Children", escape(listed(info.children, most=_MOST_CHILDREN))))
    cells = "".join(f"<dt>{name}</dt><dd>{value}</dd>" for name, value in rows)
    return f'<dl class="tf-facts">{cells}</dl>'


def explained(frame: ViewFrame) -> str:
    """A frame's state, and why; a conflict is mentioned together with gone."""
    conflict = f"conflict: sent by {' and '.join(frame.publishers)}"
    beside = f"; {conflict}" if len(frame.publishers) > 1 else ""
    return {
        "dynamic": "dynamic: its samples come",
        "static": "static: holds at all times",
        "stale": f"stale: no sample for {duration(frame.silent_s)}",
        "ahead": f"ahead: its newest stamp is {duration(frame.ahead_s)} in the future",
        "gone": f"gone: its publisher has left the bus{beside}",
        "conflict": conflict,
        "root": "root: has no parent",
    }[frame.state]


def rate_text(rate_hz: float | None) -> str:
    """A rate for people: `62 Hz`, `0.5 Hz`."""
    if rate_hz is None:
        return "not known yet"
    return f"{rate_hz:.0f} Hz" if rate_hz >= 2.0 else f"{rate_hz:.2g} Hz"


def pose_in(buffer: Buffer, target: str, source: str, stamp_ns: int | None) -> str:
    """The pose of `source` in `target` as text, or why there is none."""
    try:
        return pose_text(buffer.lookup_transform(target, source, stamp_ns))
    except TransformException as error:
        return str(error)


def pose_text(found: TransformStamped) -> str:
    """Translation, quaternion, and angles in degrees, one a line."""
    pose = found.transform
    degrees = [math.degrees(angle) for angle in pose.as_rpy()]
    return (
        f"xyz  {_DIGITS.bracketed(pose.xyz)}\n"
        f"xyzw {_DIGITS.bracketed(pose.quat_xyzw)}\n"
        f"rpy° {_DIGITS.bracketed(degrees)}"
    )


def between(buffer: Buffer, target: str, source: str, stamp_ns: int | None) -> tuple[str, str]:
    """Distance and angle between two frames, and tf2_echo's block; or "" and the reason."""
    try:
        found = buffer.lookup_transform(target, source, stamp_ns)
    except TransformException as error:
        return "", str(error)
    pose = found.transform
    distance_m = math.dist(pose.xyz, (0.0, 0.0, 0.0))
    # abs() takes the short way round: a unit quaternion may stand for the long one.
    turn_deg = math.degrees(2.0 * math.atan2(math.hypot(pose.qx, pose.qy, pose.qz), abs(pose.qw)))
    return f"{distance_m:.3f} m apart, turned by {turn_deg:.1f}°", tf2_block(found, _DIGITS)


def numbers(title: str, id_: str, text: str) -> str:
    """A block of numbers with its title; `tfbusCopy(id)` copies it."""
    return (
        f'<div class="tf-head"><span class="tf-dim">{escape(title)}</span>'
        f'<a class="tf-link" role="button" aria-label="copy {escape(title)}" '
        f"onpointerdown=\"tfbusCopy('{id_}')\">copy</a></div>"
        f'<pre id="{id_}">{escape(text)}</pre>'
    )


class MeasurePanel:
    """Shows where one frame is, seen from another, as `tfbus echo` prints it."""

    def __init__(self, gui: viser.GuiApi, view: ViewState) -> None:
        self._view = view
        self._from = FrameDropdown(
            gui, "Seen from", "choose a frame", lambda name: view.change(measure_from=name)
        )
        self._to = FrameDropdown(
            gui, "Frame", "choose a frame", lambda name: view.change(measure_to=name)
        )
        self._answer = Html(gui.add_html(""))

    def refresh(self, frames: Frames, buffer: Buffer) -> None:
        """Show the answer at the time shown."""
        settings = self._view.settings
        names = sorted(frames.by_name)
        self._from.offer(names, settings.measure_from)
        self._to.offer(names, settings.measure_to)
        if not settings.measure_from or not settings.measure_to:
            self._answer.show(
                '<div class="tf tf-dim">Choose two frames to see how far apart they are.</div>'
            )
            return
        summary, block = between(
            buffer, settings.measure_from, settings.measure_to, self._view.playback.stamp_ns
        )
        if not summary:
            self._answer.show(f'<div class="tf tf-alarm">{escape(block)}</div>')
            return
        title = shlex.join(["tfbus", "echo", settings.measure_from, settings.measure_to])
        self._answer.show(
            f'<div class="tf"><b>{escape(summary)}</b>{numbers(title, "tf-echo", block)}</div>'
        )
