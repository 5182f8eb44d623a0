"""What the panels say, as HTML: facts about a frame, what lies between two, what is awaited."""

import math
from collections.abc import Sequence
from html import escape

from tfbus import Buffer, TransformException, TransformStamped
from tfbus.frames.blocks import Numbers, stamp_text, tf2_block
from tfbus.view.model.frames import Frames
from tfbus.view.model.playback import Playback
from tfbus.view.model.status import FrameState, Status
from tfbus.view.panels.markup import sign

_MOST_MISTAKES = 5

_DIGITS = Numbers(precision=3)


def headline(frames: Frames, fixed_frame: str, playback: Playback, missing: int = 0) -> str:
    """What the page shows, or what it waits for.

    `missing` frames have no place at the time that is shown, beside those of other trees.
    """
    if not len(frames):
        return (
            '<div class="tf" role="status"><b>Waiting for transforms.</b> None has come yet: start '
            "a broadcaster on this bus, for example <code>tfbus launch turtle</code>.</div>"
        )
    if fixed_frame not in frames:
        known = ", ".join(escape(root) for root in frames.roots[:5])
        return (
            f'<div class="tf" role="status"><b>There is no frame {escape(repr(fixed_frame))}</b> '
            f"to see the others from; choose another fixed frame. Roots: {known}.</div>"
        )
    counts = {status: sum(state.status is status for state in frames) for status in Status}
    notes = [
        f'<span class="tf-note-whole">{sign(status)} {counts[status]} {status.value}</span>'
        for status in (Status.CONFLICT, Status.GONE, Status.STALE)
        if counts[status]
    ]
    apart = missing + sum(bool(state.unplaced) for state in frames)
    if apart:
        notes.append(f'<span class="tf-alarm tf-note-whole">{apart} without a place</span>')
    frames_text = "1 frame" if len(frames) == 1 else f"{len(frames)} frames"
    parts = [f"{frames_text}, seen from <b>{escape(fixed_frame)}</b>", *notes]
    if playback.stamp_ns is not None:
        parts.append(f"<b>paused</b> at {stamp_text(playback.stamp_ns)}")
    return f'<div class="tf" role="status">{" · ".join(parts)}</div>'


def mistakes(said: Sequence[str]) -> str:
    """What is wrong, a line each; of many the first."""
    lines = [*said[:_MOST_MISTAKES]]
    if len(said) > _MOST_MISTAKES:
        lines.append(f"And {len(said) - _MOST_MISTAKES} more; the log has them.")
    return "".join(f'<div class="tf tf-alarm" role="alert">{escape(line)}</div>' for line in lines)


def seconds(value: float) -> str:
    """A duration as short as it can be read: `0.02 s`, `3.1 s`, `75 s`."""
    digits = 0 if abs(value) >= 10.0 else 1 if abs(value) >= 1.0 else 2
    return f"{value:.{digits}f} s"


def pose_text(found: TransformStamped) -> str:
    """Translation, quaternion, and angles in degrees, one a line."""
    pose = found.transform
    degrees = [math.degrees(angle) for angle in pose.as_rpy()]
    return (
        f"xyz  {_DIGITS.bracketed(pose.xyz)}\n"
        f"xyzw {_DIGITS.bracketed(pose.quat_xyzw)}\n"
        f"rpy° {_DIGITS.bracketed(degrees)}"
    )


def facts(state: FrameState, now_ns: int) -> str:
    """Who publishes a frame, how often, and how old it is."""
    info = state.info
    rows = [("State", f"{sign(state.status)} {escape(explained(state))}")]
    if info.parent is not None:
        rows.append(("Parent", escape(info.parent)))
        rows.append(("Publisher", escape(", ".join(state.publishers) or "unnamed")))
        rows.append(("Rate", "static" if info.static else rate_text(info.rate_hz)))
    if info.newest_ns is not None and not info.static:
        rows.append(("Age", seconds((now_ns - info.newest_ns) / 1e9)))
    if info.children:
        rows.append(("Children", escape(", ".join(info.children[:20]))))
    cells = "".join(f"<dt>{name}</dt><dd>{value}</dd>" for name, value in rows)
    return f'<dl class="tf-facts">{cells}</dl>'


def explained(state: FrameState) -> str:
    """A status in some words: why it is this one."""
    return {
        Status.FRESH: "fresh",
        Status.STATIC: "static: holds at all times",
        Status.STALE: f"stale: nothing new for {seconds(state.silent_s)}",
        Status.GONE: "gone: its publisher has left the bus",
        Status.CONFLICT: f"conflict: sent by {' and '.join(state.publishers)}",
        Status.ROOT: "a root: has no parent",
    }[state.status]


def rate_text(rate_hz: float | None) -> str:
    """A rate for people: `62 Hz`, `0.5 Hz`."""
    if rate_hz is None:
        return "not known yet"
    return f"{rate_hz:.0f} Hz" if rate_hz >= 2.0 else f"{rate_hz:.2g} Hz"


def numbers(title: str, id_: str, text: str) -> str:
    """A block of numbers with its title, which `tfbusCopy(id)` copies."""
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
    """Distance and angle from one frame to another, and tf2_echo's block; or why there is none."""
    try:
        found = buffer.lookup_transform(target, source, stamp_ns)
    except TransformException as error:
        return "", str(error)
    pose = found.transform
    distance_m = math.dist(pose.xyz, (0.0, 0.0, 0.0))
    # Of a unit quaternion, which may stand for the long way round: take the short one.
    turn_deg = math.degrees(2.0 * math.atan2(math.hypot(pose.qx, pose.qy, pose.qz), abs(pose.qw)))
    return f"{distance_m:.3f} m apart, turned by {turn_deg:.1f}°", tf2_block(found, _DIGITS)
