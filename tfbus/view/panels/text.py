"""Texts of the panels, as HTML: facts about a frame, the way between two, what the page awaits."""

import math
from collections.abc import Sequence
from datetime import UTC, datetime
from html import escape

from tfbus.buffer.buffer import Buffer
from tfbus.errors import TransformException
from tfbus.frames.document import Numbers, tf2_block
from tfbus.geometry.transform import TransformStamped
from tfbus.view.model.frames import FAULTS, Frames, ViewFrame
from tfbus.view.model.settings import Playback
from tfbus.view.panels.markup import sign
from tfbus.wording import and_more, counted, duration, listed, printable, stamp_text

_MOST_MISTAKES = 5
_MOST_ROOTS = 5
_MOST_CHILDREN = 20

# Stamps before 1980 are not dates: simulated time begins at 0. Those after 9999 have none.
FIRST_DATE_NS = 315_532_800 * 1_000_000_000
_MOST_DATE_S = 253_402_000_000

WAITING = (
    "<b>Waiting for transforms.</b> None has come yet: start a broadcaster on this bus, for "
    "example <code>tfbus launch turtle</code>."
)

_DIGITS = Numbers(precision=3)


def headline(
    frames: Frames,
    fixed_frame: str,
    playback: Playback,
    missing: int = 0,
    now_ns: int = 0,
    empty: str = WAITING,
    loading: str = "",
) -> str:
    """The headline of the page, or what it waits for; `now_ns` is the time to judge a pause by.

    `missing` frames have no place at the time shown, besides those of other trees. `empty` is what
    to say without any frame, as HTML. `loading` says how far the meshes of robots are loaded.
    """
    loads = [f'<span class="tf-note-whole">loading {loading}</span>'] if loading else []
    if not len(frames):
        return f'<div class="tf" role="status">{" · ".join([empty, *loads])}</div>'
    if fixed_frame not in frames:
        known = listed([escape(root) for root in frames.roots], most=_MOST_ROOTS)
        return (
            f'<div class="tf" role="status"><b>There is no frame {escape(repr(fixed_frame))}</b> '
            f"to see the others from; choose another fixed frame. Roots: {known}.</div>"
        )
    counts = {fault: sum(frame.state == fault for frame in frames) for fault in FAULTS}
    notes = [
        f'<span class="tf-note-whole">{sign(fault)} {count} {fault}</span>'
        for fault, count in counts.items()
        if count
    ]
    apart = missing + sum(bool(frame.unplaced) for frame in frames)
    if apart:
        notes.append(f'<span class="tf-alarm tf-note-whole">{apart} without a place</span>')
    parts = [f"{counted(len(frames), 'frame')}, seen from <b>{escape(fixed_frame)}</b>", *notes]
    parts += loads
    if playback.stamp_ns is not None:
        ago_s = (now_ns - playback.stamp_ns) / 1e9
        ago = f", {duration(ago_s)} ago" if ago_s >= 0.1 else ""
        parts.append(f"<b>paused</b> at {clock_time(playback.stamp_ns, now_ns)}{ago}")
    return f'<div class="tf" role="status">{" · ".join(parts)}</div>'


def robots_alone(titles: Sequence[str]) -> str:
    """The note on robots without any frame, as HTML."""
    named = escape(listed([printable(title) for title in titles], most=3))
    return (
        f"<b>No transforms yet.</b> <code>tfbus robot_state</code> publishes the frames of {named} "
        "from <code>joint_states</code>, and <code>tfbus joints</code> publishes those."
    )


def nothing_recorded(hint: str) -> str:
    """The note on a recording without a frame, as HTML; `hint` is where there are some."""
    where = f" {escape(hint[:1].upper() + hint[1:])}." if hint else ""
    return f"<b>No transforms</b> had come by this moment of the recording.{where}"


def clock_time(stamp_ns: int, now_ns: int) -> str:
    """A stamp as a local time, with the date if that is another day than now; as HTML.

    Simulated time, which begins at 0, stays in seconds. A tooltip has the whole stamp.
    """
    if stamp_ns < FIRST_DATE_NS:
        text = f"{stamp_ns / 1e9:.3f} s"
    else:
        # In whole milliseconds, cut, as clocks show them.
        at, now = (_local(ns) for ns in (stamp_ns, now_ns))
        day = "" if at.date() == now.date() else f"{at:%Y-%m-%d} "
        text = f"{day}{at:%H:%M:%S}.{stamp_ns // 1_000_000 % 1000:03}"
    return f'<span class="tf-note-whole" title="{stamp_text(stamp_ns)}">{text}</span>'


def _local(stamp_ns: int) -> datetime:
    """The local time, to the second; the last that a datetime can hold for those after it."""
    seconds = min(stamp_ns // 1_000_000_000, _MOST_DATE_S)
    return datetime.fromtimestamp(seconds, UTC).astimezone()


def mistakes(found: Sequence[str]) -> str:
    """A line per mistake, at most five."""
    lines = [*found[:_MOST_MISTAKES]]
    if more := and_more(len(found), _MOST_MISTAKES):
        lines.append(f"{more.capitalize()}; see the log.")
    return "".join(f'<div class="tf tf-alarm" role="alert">{escape(line)}</div>' for line in lines)


def pose_text(found: TransformStamped) -> str:
    """Translation, quaternion, and angles in degrees, one a line."""
    pose = found.transform
    degrees = [math.degrees(angle) for angle in pose.as_rpy()]
    return (
        f"xyz  {_DIGITS.bracketed(pose.xyz)}\n"
        f"xyzw {_DIGITS.bracketed(pose.quat_xyzw)}\n"
        f"rpy° {_DIGITS.bracketed(degrees)}"
    )


def facts(frame: ViewFrame, now_ns: int) -> str:
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


def numbers(title: str, id_: str, text: str) -> str:
    """A block of numbers with its title; `tfbusCopy(id)` copies it."""
    return (
        f'<div class="tf-head"><span class="tf-dim">{escape(title)}</span>'
        f'<a class="tf-link" role="button" aria-label="copy {escape(title)}" '
        f"onpointerdown=\"tfbusCopy('{id_}')\">copy</a></div>"
        f'<pre id="{id_}">{escape(text)}</pre>'
    )


def pose_in(buffer: Buffer, target: str, source: str, stamp_ns: int | None) -> str:
    """The pose of `source` in `target` as text, or why there is none."""
    try:
        return pose_text(buffer.lookup_transform(target, source, stamp_ns))
    except TransformException as error:
        return str(error)


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
