"""Which time is shown: the latest, or a held one that the slider moves."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Playback:
    """Shows the latest time while `held_ns` is None, else `ago_s` seconds before `held_ns`."""

    held_ns: int | None = None
    ago_s: float = 0.0

    @property
    def follows(self) -> bool:
        """Whether the latest time is shown."""
        return self.held_ns is None

    @property
    def stamp_ns(self) -> int | None:
        """The time shown; None is the latest of each frame."""
        return None if self.held_ns is None else self.held_ns - round(self.ago_s * 1e9)

    def pause(self, now_ns: int) -> "Playback":
        """Hold this time; a time already held stays."""
        return Playback(now_ns) if self.follows else self

    def scrub(self, now_ns: int, ago_s: float) -> "Playback":
        """Show the time `ago_s` before the held one; holds `now_ns` if none is held."""
        return Playback(now_ns if self.held_ns is None else self.held_ns, ago_s)
