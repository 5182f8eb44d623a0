"""The bus as it is now, for programs: moments, and the changes from one to the next.

Apart from `changes`, which tools on recordings import, and with it no bus.
"""

from collections.abc import Iterator

from tfbus.base.clock import SYSTEM_CLOCK
from tfbus.buffer.buffer import Buffer
from tfbus.frames.changes import BusChange, Changes, check_period
from tfbus.frames.command_listener import Listening, meet_publishers
from tfbus.frames.moment import BusMoment
from tfbus.node.node import Node
from tfbus.streams.listener import TransformListener
from tfbus.wire.fleet import Fleet

# Publishers that keep messages show their rates at once.
_HISTORY_S = 3.0
_MEET_WITHIN_S = 2.0


class Watch:
    """The bus as it is now, seen by a listener of this node: its namespace, or a `fleet`.

    Use it in a `with`, or `close()` it. It waits until the publishers that are there have been
    heard, 3 s at the most, so make it outside of callbacks. `buffer` has the transforms.
    """

    def __init__(self, node: Node, *, fleet: Fleet | None = None) -> None:
        self.buffer = Buffer()
        listener = TransformListener(self.buffer, node, history_s=_HISTORY_S, fleet=fleet)
        self._node = node
        self._heard = Listening(node, self.buffer, listener, fleet)
        meet_publishers(self._heard, _MEET_WITHIN_S)
        self._heard.watch_nodes()

    def __enter__(self) -> "Watch":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Stop listening. Twice is fine; closing the node does it too."""
        self._heard.close()

    def now(self) -> BusMoment:
        """The bus now, with topics of nodes as they were up to a second ago."""
        return self._heard.moment()

    def changes(self, period_s: float = 0.2) -> Iterator[BusChange]:
        """The changes of the bus, until the node is closed: first of all that is there, then each
        when it is noticed, at most `period_s` later.
        """
        check_period(period_s)
        return self._changes(period_s)

    def _changes(self, period_s: float) -> Iterator[BusChange]:
        changes = Changes()
        while self._node.ok:
            yield from changes.to(self.now())
            if not self._node.wait(period_s, clock=SYSTEM_CLOCK):
                return
