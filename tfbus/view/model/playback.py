"""Which time is shown: the newest, or one that is held and moved along by hand."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Playback:
    """Follows what comes where `held_ns` is None; else shows `ago_s` seconds before that time."""

    held_ns: int | None = None
    ago_s: float = 0.0

    @property
    def follows(self) -> bool:
        """Whether what is shown moves on by itself."""
        return self.held_ns is None

    @property
    def stamp_ns(self) -> int | None:
        """The time shown; None is the latest of each frame."""
        return None if self.held_ns is None else self.held_ns - round(self.ago_s * 1e9)

    def pause(self, now_ns: int) -> "Playback":
        """Hold this time; where one is held already, it stays."""
        return Playback(now_ns) if self.follows else self

    def scrub(self, now_ns: int, ago_s: float) -> "Playback":
        """Show the time so many seconds before the one held, which now becomes if none is."""
        return Playback(now_ns if self.held_ns is None else self.held_ns, ago_s)
