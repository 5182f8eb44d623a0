"""Frames of the namespaces below ours: what to say to those who look for one here."""

from collections.abc import Collection

from tfbus.bus.session import Session
from tfbus.discover.presence import describe_streams
from tfbus.errors import DecodeError
from tfbus.wire.keys import namespace_of

# Of the namespaces that have a frame so many are named.
_NAMED = 3


def frames_elsewhere(session: Session) -> set[tuple[str, str]]:
    """The frames that streams of the namespaces below tell of, each behind its namespace."""

    def pass_over(error: DecodeError) -> None:
        """Nothing is said of strangers here."""

    streams = describe_streams(session, pass_over)
    return {
        (namespace, frame)
        for key, stream in streams.items()
        if (namespace := namespace_of(key))
        for parent, child, _ in stream.frames
        for frame in (parent, child)
    }


def where_to_look(elsewhere: Collection[tuple[str, str]], frame: str = "") -> str:
    """Where a frame is known, or any frame at all, and how to look there; "" where it is nowhere.

    It is called by its own name, or as a fleet calls it: `robot7/base_link`.
    """
    having = {
        namespace
        for namespace, name in elsewhere
        if not frame or frame in (name, f"{namespace}/{name}")
    }
    if not having:
        return ""
    named = " or ".join(sorted(having)[:_NAMED])
    known = f"{frame!r} is" if frame else "frames are"
    return f"{known} known in other namespaces: look with --namespace {named}, or with --fleet"
