"""Checks of how transforms are used: who reads them, and how long they are kept."""

from tfbus.doctor.examination import Examination
from tfbus.doctor.finding import Finding, first_of, found, ok, skipped
from tfbus.wording import counted, duration

# A few unread streams are normal at the start; many are forgotten ones.
_FEW_UNREAD = 10


def check_unread(seen: Examination) -> Finding:
    """At most ten streams are unread."""
    if not any(node.streams for node in seen.nodes):
        return skipped("no node publishes a frame")
    unread = [
        f"no node reads the dynamic frames of stream {stream!r} of {node.name}"
        for node in seen.nodes
        for stream in node.unread
    ]
    if len(unread) <= _FEW_UNREAD:
        return ok(*(unread or ["each stream is read"]))
    return Finding(
        "warn",
        tuple(first_of(unread)),
        "stop their nodes, or start the nodes that should read them",
    )


def check_buffers(seen: Examination) -> Finding:
    """Buffers are long enough for their lookups."""
    buffers = [(node, buffer) for node in seen.nodes for buffer in node.buffers]
    if not buffers:
        return skipped("no node has a buffer")
    short = [
        f"{node.name} keeps {duration(buffer.cache_time_s)}, but "
        f"{counted(buffer.too_old, 'lookup')} asked for older data, by up to "
        f"{duration(buffer.missed_by_s)}"
        for node, buffer in buffers
        if buffer.too_old
    ]
    return found(
        "warn",
        short,
        "give it a longer cache (Buffer(cache_time_s=...)), or look up sooner",
        counted(len(buffers), "buffer"),
    )


def check_dropped(seen: Examination) -> Finding:
    """Listeners drop no messages."""
    buffers = [(node, buffer) for node in seen.nodes for buffer in node.buffers]
    if not buffers:
        return skipped("no node has a buffer")
    dropped = [
        f"{node.name} dropped {counted(buffer.dropped, 'message')}: transforms come on more keys "
        "than it accepts"
        for node, buffer in buffers
        if buffer.dropped
    ]
    return found(
        "fail",
        dropped,
        "do not split streams of many frames, or read only what is needed (reads='needed')",
        "no message was dropped",
    )
