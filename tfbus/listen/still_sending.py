"""Brings streams back that count as gone and still send.

A token may be lost with its link while messages come by another one (eclipse-zenoh/zenoh#2806).
"""

from tfbus.listen.registry import Registry
from tfbus.listen.watch import StreamWatch
from tfbus.runtime import scheduler
from tfbus.runtime.executor import Executor
from tfbus.runtime.structs import Struct

# A stream that sends for so long after its token was lost is not gone. What is under way when a
# process is killed comes before that.
_SENDS_FOR_S = 2.0

# A stream that was brought back so is gone when it is silent for so long.
_SILENT_S = 5.0

_EVERY_S = 1.0


class _Heard(Struct, frozen=False):
    """When a stream was last looked at and had sent, by a clock that nobody sets."""

    gone_s: float
    last_ns: int | None
    looked_s: float
    heard_s: float

    def look(self, last_ns: int | None, now_s: float) -> None:
        """Note when the last message came, by the system's clock, which may be set."""
        if last_ns != self.last_ns:
            # It came since the look before.
            self.last_ns, self.heard_s = last_ns, self.looked_s
        self.looked_s = now_s


class StillSending:
    """Looks at the streams that are gone, while there are any. All on the executor's thread."""

    def __init__(self, registry: Registry, watch: StreamWatch, executor: Executor) -> None:
        self._registry = registry
        self._watch = watch
        self._executor = executor
        # Those that are gone, and those of them that were brought back.
        self._gone: dict[str, _Heard] = {}
        self._back: dict[str, _Heard] = {}
        self._is_looking = False

    def note_gone(self, name: str) -> None:
        """Look from now on whether a stream goes on to send."""
        now_s = scheduler.monotonic()
        self._gone[name] = _Heard(now_s, self._last_ns(name), now_s, now_s)
        self._back.pop(name, None)
        self._look_later()

    def _last_ns(self, name: str) -> int | None:
        stream = self._registry.get(name)
        return None if stream is None else stream.reception.counts.last_heard_ns

    def _look_later(self) -> None:
        if not self._is_looking and (self._gone or self._back):
            self._is_looking = True
            self._executor.after(_EVERY_S, self._look)

    def _look(self) -> None:
        self._is_looking = False
        now_s = scheduler.monotonic()
        for name, heard in list(self._gone.items()):
            heard.look(self._last_ns(name), now_s)
            stream = self._registry.get(name)
            if stream is None or stream.state is None or stream.state.alive:
                del self._gone[name]
            elif heard.heard_s - heard.gone_s >= _SENDS_FOR_S:
                self._back[name] = self._gone.pop(name)
                self._watch.take_for_alive(stream.state.key)
        for name, heard in list(self._back.items()):
            heard.look(self._last_ns(name), now_s)
            stream = self._registry.get(name)
            if stream is None or stream.state is None or self._watch.has_token(stream.state.key):
                del self._back[name]
            elif now_s - heard.heard_s > _SILENT_S:
                del self._back[name]
                self._watch.take_for_gone(stream.state.key)
        self._look_later()
