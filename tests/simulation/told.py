"""Changes that a buffer tells of its frames, compared with its frames."""

from typing import Any


class Told:
    """The frames of a buffer by the changes that it has told, each with whether it is gone."""

    def __init__(self, buffer: Any) -> None:
        self._buffer = buffer
        self._frames: dict[str, bool] = {}
        buffer.on_change(self._take)

    def _take(self, change: Any) -> None:
        if change.kind == "removed":
            self._frames.pop(change.frame, None)
        elif change.kind in ("added", "publisher gone", "publisher back"):
            self._frames[change.frame] = change.kind == "publisher gone"

    def mistake(self) -> str:
        """The frames of which it has told something else than it has; "" for none."""
        # The root, which has no transforms, goes with its last child, and nothing is told of it.
        told = {(frame, gone) for frame, gone in self._frames.items() if frame != "world"}
        infos = self._buffer.all_frames()
        held = {(info.name, info.gone) for info in infos if info.name != "world"}
        if told == held:
            return ""
        return f"it has told of frames {sorted(told - held)}, and holds {sorted(held - told)}"
