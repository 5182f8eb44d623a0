"""Checks of what is made of transforms: who reads them, and for how long they are kept."""

from tfbus.doctor.examination import Examination
from tfbus.doctor.finding import Finding, found, ok, skipped
from tfbus.wording import counted, duration

# What nobody reads yet is how most begin; of many somebody has forgotten what they were for.
_FEW_UNREAD = 10


def check_unread(seen: Examination) -> Finding:
    """Streams are read, or few enough that it does not matter."""
    unread = [
        f"nobody reads the moving frames of stream {stream!r} of {node.name}"
        for node in seen.nodes
        for stream in node.unread
    ]
    if len(unread) <= _FEW_UNREAD:
        return ok(*(unread or ["each stream is read"]))
    rest = len(unread) - _FEW_UNREAD
    return Finding(
        "warn",
        (*unread[:_FEW_UNREAD], f"and those of {counted(rest, 'more stream')}"),
        "stop their nodes, or start what was to read them",
    )


def check_buffers(seen: Examination) -> Finding:
    """Buffers are long enough for the lookups that are made in them."""
    told = [(node, buffer) for node in seen.nodes for buffer in node.buffers]
    if not told:
        return skipped("no node has a buffer")
    short = [
        f"{node.name} keeps {duration(buffer.cache_time_s)}, but "
        f"{counted(buffer.too_old, 'lookup')} asked for times before that, by up to "
        f"{duration(buffer.missed_by_s)}"
        for node, buffer in told
        if buffer.too_old
    ]
    return found(
        "warn",
        short,
        "give it a longer cache (Buffer(cache_time_s=...)), or look up sooner",
        counted(len(told), "buffer"),
    )


def check_dropped(seen: Examination) -> Finding:
    """Listeners take what comes, on however many keys."""
    told = [(node, buffer) for node in seen.nodes for buffer in node.buffers]
    if not told:
        return skipped("no node has a buffer")
    dropped = [
        f"{node.name} dropped {counted(buffer.dropped, 'message')}: transforms come on more keys "
        "than it takes"
        for node, buffer in told
        if buffer.dropped
    ]
    return found(
        "fail",
        dropped,
        "let streams of many frames not be split, or read what is needed (reads='needed')",
        "all messages were taken",
    )
