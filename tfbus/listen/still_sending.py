"""Brings streams back that count as gone and still send.

A token may be lost with its link while messages come by another one (eclipse-zenoh/zenoh#2806).
"""

from tfbus.listen.registry import Registry
from tfbus.listen.watch import StreamWatch
from tfbus.runtime import scheduler
from tfbus.runtime.executor import Executor

# A stream that sends for so long after its token was lost is not gone. What is under way when a
# process is killed comes before that.
_SENDS_FOR_S = 2.0

# A stream that was brought back so is looked at as often, and gone when nothing has come since.
_LOOKED_AT_EVERY_S = 5.0


class StillSending:
    """Looks at the streams that it has brought back, while there are any; before that their
    messages tell.
    """

    def __init__(self, registry: Registry, watch: StreamWatch, executor: Executor) -> None:
        self._registry = registry
        self._watch = watch
        self._executor = executor
        # How many messages each had sent when it was last looked at. On the executor's thread.
        self._back: dict[str, int] = {}
        self._is_looking = False

    def note_message(self, name: str) -> None:
        """Bring a stream back of which a message has come though it is gone. From any thread."""
        stream = self._registry.get(name)
        lost_s = None if stream is None else stream.lost_s
        if lost_s is not None and scheduler.monotonic() - lost_s > _SENDS_FOR_S:
            self._executor.submit("a stream that sends", lambda: self._bring_back(name), limit=1)

    def _bring_back(self, name: str) -> None:
        stream = self._registry.get(name)
        if stream is not None and stream.state is not None and not stream.state.alive:
            self._back[name] = stream.reception.counts.messages
            self._watch.take_for_alive(stream.state.key)
            self._look_later()

    def _look_later(self) -> None:
        if not self._is_looking and self._back:
            self._is_looking = True
            self._executor.after(_LOOKED_AT_EVERY_S, self._look)

    def _look(self) -> None:
        self._is_looking = False
        for name, former in list(self._back.items()):
            stream = self._registry.get(name)
            state = None if stream is None else stream.state
            if stream is None or state is None or self._watch.has_token(state.key):
                del self._back[name]
            elif (messages := stream.reception.counts.messages) == former:
                del self._back[name]
                self._watch.take_for_gone(state.key)
            else:
                self._back[name] = messages
        self._look_later()
