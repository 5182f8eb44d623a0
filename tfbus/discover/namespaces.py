"""The frames of other namespaces: which namespace has a frame, and how to look there."""

from collections.abc import Collection
from typing import TYPE_CHECKING

from tfbus.wire.keys import namespace_of
from tfbus.wording import natural_order

if TYPE_CHECKING:
    from tfbus.bus.session import Session

# At most this many namespaces are named.
_NAMED = 3


def frames_in_other_namespaces(session: "Session") -> set[tuple[str, str]]:
    """Namespace and name of each frame in the descriptions of streams in namespaces below."""
    from tfbus.discover.presence import ask_streams  # Zenoh, which a recording does not need

    return {
        (namespace, frame)
        for key, stream in ask_streams(session).streams.items()
        if (namespace := namespace_of(key))
        for parent, child, _ in stream.frames
        for frame in (parent, child)
    }


def where_to_look(frames_in_other_namespaces: Collection[tuple[str, str]], frame: str = "") -> str:
    """A hint which namespaces have this frame, or any frame, and how to look there; "" for none.

    The frame goes by its own name, or by that in a fleet: `robot7/base_link`.
    """
    having = {
        namespace
        for namespace, name in frames_in_other_namespaces
        if not frame or frame in (name, f"{namespace}/{name}")
    }
    if not having:
        return ""
    known = f"{frame!r} is" if frame else "frames are"
    if "" in having:
        return f"{known} known outside of this namespace: look without --namespace"
    named = " or ".join(sorted(having, key=natural_order)[:_NAMED])
    return f"{known} known in other namespaces: look with --namespace {named}, or with --fleet"
