"""How a stream sends the transforms that change with time."""

import math
from dataclasses import dataclass
from operator import index
from typing import SupportsFloat, SupportsIndex

from tfbus.errors import InvalidArgumentException


@dataclass(frozen=True)
class StreamOptions:
    """How a stream sends its dynamic transforms; all its broadcasters have the same options.

    With `split` each frame has a key of its own. Of two publishers of one frame, listeners with
    `conflicts="priority"` accept the one of higher `priority`, a 32-bit integer. Messages of the
    last `history_s` seconds are kept for listeners that join later. Raises
    InvalidArgumentException if one is invalid.
    """

    split: bool = False
    priority: int = 0
    history_s: float = 10.0

    def __post_init__(self) -> None:
        history_s: object = self.history_s
        if not isinstance(history_s, SupportsFloat) or not 0.0 <= float(history_s) < math.inf:
            raise InvalidArgumentException(
                f"history_s must be a number of seconds, 0 or more, not {self.history_s!r}"
            )
        priority: object = self.priority
        if not isinstance(priority, SupportsIndex) or not -(2**31) <= index(priority) < 2**31:
            raise InvalidArgumentException(
                f"priority must be a 32-bit integer, not {self.priority!r}"
            )
        object.__setattr__(self, "priority", index(priority))

    def __str__(self) -> str:
        return f"split={self.split}, priority={self.priority}, history_s={self.history_s:g}"
