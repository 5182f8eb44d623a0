"""The bus as it is now, for programs: moments, and the changes from one to the next.

Apart from `changes`, which tools on recordings import, and with it no bus.
"""

from collections.abc import Iterator

from tfbus.buffer.buffer import Buffer
from tfbus.discover.presence import watch_nodes
from tfbus.frames.changes import BusChange, Changes
from tfbus.frames.command_listener import Listening, meet_publishers
from tfbus.frames.moment import BusMoment
from tfbus.listen.listener import TransformListener
from tfbus.node.node import Node
from tfbus.runtime.clock import SYSTEM_CLOCK, Pace
from tfbus.wire.fleet import Fleet

# Publishers that keep messages show their rates at once.
_HISTORY_S = 3.0
_MEET_WITHIN_S = 2.0

# A node describes its topics soon after its token comes, and changes them now and then.
_SOON_S, _ASK_EVERY_S = 0.5, 5.0


class Watch:
    """The bus as it is now, seen by a listener of this node: its namespace, or a `fleet`.

    Use it in a `with`, or `close()` it. It waits until the publishers that are there have been
    heard, 2 s at the most, so make it outside of callbacks. `buffer` has the transforms.
    """

    def __init__(self, node: Node, *, fleet: Fleet | None = None) -> None:
        self.buffer = Buffer()
        listener = TransformListener(self.buffer, node, history_s=_HISTORY_S, fleet=fleet)
        self._node = node
        self._heard = Listening(node, self.buffer, listener, fleet)
        self._pace = Pace(_ASK_EVERY_S, _SOON_S)
        self._tokens = watch_nodes(node.session, self._on_token)
        meet_publishers(self._heard, _MEET_WITHIN_S)

    def __enter__(self) -> "Watch":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Stop listening. Twice is fine; closing the node does it too."""
        self._tokens.close()
        self._heard.listener.close()

    def now(self) -> BusMoment:
        """The bus now. It takes up to 2 s when nodes came or left, and every 5 s, since it then
        asks the nodes for their descriptions.
        """
        if self._pace.is_due():
            self._heard.ask_nodes()
        return self._heard.moment()

    def changes(self, period_s: float = 0.2) -> Iterator[BusChange]:
        """The changes of the bus, until the node is closed: first of all that is there, then each
        when it is noticed, at most `period_s` later.
        """
        changes = Changes()
        while self._node.ok:
            yield from changes.to(self.now())
            if not self._node.wait(period_s, clock=SYSTEM_CLOCK):
                return

    def _on_token(self, name: str, alive: bool) -> None:
        self._pace.note_news()
