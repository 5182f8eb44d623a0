"""How a stream sends the transforms that change with time."""

import math
from dataclasses import dataclass

from tfbus.errors import InvalidArgumentException


@dataclass(frozen=True)
class StreamOptions:
    """How a stream sends what moves; its broadcasters agree on it.

    With `split` each frame has a key of its own. Of two publishers of one frame that of higher
    `priority` wins where the listener goes by it. `history_s` is how many seconds of messages are
    kept for those who join. Raises InvalidArgumentException where one of them cannot be.
    """

    split: bool = False
    priority: int = 0
    history_s: float = 10.0

    def __post_init__(self) -> None:
        if not 0.0 <= self.history_s < math.inf:
            raise InvalidArgumentException(
                f"history_s is {self.history_s!r}; it is a number of seconds, 0 or more"
            )
        if not -(2**31) <= self.priority < 2**31:
            raise InvalidArgumentException(
                f"priority is {self.priority!r}; it is an integer of 32 bits"
            )

    def __str__(self) -> str:
        return f"split={self.split}, priority={self.priority}, history_s={self.history_s:g}"
