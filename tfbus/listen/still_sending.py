"""Brings streams back that count as gone and still send.

A token may be lost with its link while messages come by another one (eclipse-zenoh/zenoh#2806).
"""

from tfbus.listen.registry import Registry
from tfbus.listen.watch import StreamWatch
from tfbus.runtime import scheduler
from tfbus.runtime.executor import Executor

# A stream that sends for so long after its token was lost is not gone. What is under way when a
# process is killed comes before that.
_SENDS_FOR_NS = 2 * 10**9

# A stream that was brought back so is gone when it is silent for so long.
_SILENT_NS = 5 * 10**9

_EVERY_S = 1.0


class StillSending:
    """Looks at the streams that are gone, while there are any. All on the executor's thread."""

    def __init__(self, registry: Registry, watch: StreamWatch, executor: Executor) -> None:
        self._registry = registry
        self._watch = watch
        self._executor = executor
        # When each was gone, and those that were brought back.
        self._gone_ns: dict[str, int] = {}
        self._back: set[str] = set()
        self._is_looking = False

    def note_gone(self, name: str) -> None:
        """Look from now on whether a stream goes on to send."""
        self._gone_ns[name] = scheduler.time_ns()
        self._back.discard(name)
        self._look_later()

    def _look_later(self) -> None:
        if not self._is_looking and (self._gone_ns or self._back):
            self._is_looking = True
            self._executor.after(_EVERY_S, self._look)

    def _look(self) -> None:
        self._is_looking = False
        for name, gone_ns in list(self._gone_ns.items()):
            stream = self._registry.get(name)
            if stream is None or stream.state is None or stream.state.alive:
                del self._gone_ns[name]
            elif (stream.reception.counts.last_heard_ns or 0) - gone_ns > _SENDS_FOR_NS:
                del self._gone_ns[name]
                self._back.add(name)
                self._watch.take_for_alive(stream.state.key)
        for name in list(self._back):
            stream = self._registry.get(name)
            heard_ns = None if stream is None else stream.reception.counts.last_heard_ns
            if stream is None or stream.state is None or self._watch.has_token(stream.state.key):
                self._back.discard(name)
            elif scheduler.time_ns() - (heard_ns or 0) > _SILENT_NS:
                self._back.discard(name)
                self._watch.take_for_gone(stream.state.key)
        self._look_later()
