"""What a buffer knows about one frame."""

from dataclasses import dataclass


@dataclass(frozen=True)
class FrameInfo:
    """A frame, and the edge that joins it to its parent.

    `parent` is None for a root, which has no edge: then the rest but `children` is empty.
    `samples` is how many are held; `static` whether the edge holds at all times.
    `rate_hz` is how often samples come, None for static frames and below two samples.
    `oldest_ns` and `newest_ns` are the stamps of the samples held, in nanoseconds since the Unix
    epoch, None without one. `authority` is who sent the last sample. `conflicts` counts samples
    that repeated a stamp with a different value, `refused` those that came too old to be kept.
    `gone` is whether its publisher is gone, as a listener has noticed: killed, closed, or out of
    reach.
    """

    name: str
    parent: str | None = None
    children: tuple[str, ...] = ()
    static: bool = False
    samples: int = 0
    rate_hz: float | None = None
    oldest_ns: int | None = None
    newest_ns: int | None = None
    authority: str = ""
    conflicts: int = 0
    refused: int = 0
    gone: bool = False
