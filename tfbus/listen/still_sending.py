"""Checks by messages what tokens and descriptions leave open.

Streams that count as gone and still send come back: a token may be lost with its link while
messages come by another one (eclipse-zenoh/zenoh#2806).

Frames that a publisher has sent, does not list, and sends no more are dropped: it has removed them.
A list that comes after a message of a frame, and does not have it, may be older than the message or
newer than the end of the frame. Only time tells: a publisher lists a frame within a second of its
first message.
"""

from collections.abc import Callable, Iterable

from tfbus.listen.registry import Registry
from tfbus.listen.watch import StreamWatch
from tfbus.runtime import scheduler
from tfbus.runtime.executor import Executor

# A frame that is neither listed nor sent for so long has been removed.
SILENT_S = 2.0


class UnlistedFrames:
    """Frames of streams that do not list them, and when each was last sent; safe from any thread.

    `drop(stream, frames)` is called on the executor's thread for those that are silent.
    """

    def __init__(self, executor: Executor, drop: Callable[[str, frozenset[str]], object]) -> None:
        self._executor = executor
        self._drop = drop
        self._lock = scheduler.Lock()
        self._heard_s: dict[str, dict[str, float]] = {}

    def hear(self, stream: str, frames: Iterable[str]) -> None:
        """A stream that does not list these frames has sent them."""
        now_s = scheduler.monotonic()
        with self._lock:
            is_new = stream not in self._heard_s
            self._heard_s.setdefault(stream, {}).update(dict.fromkeys(frames, now_s))
        if is_new:
            self._look_later(stream)

    def _look_later(self, stream: str) -> None:
        self._executor.after(SILENT_S, lambda: self._look(stream))

    def _look(self, stream: str) -> None:
        since_s = scheduler.monotonic() - SILENT_S
        with self._lock:
            heard_s = self._heard_s.pop(stream)
            silent = frozenset(frame for frame, at_s in heard_s.items() if at_s <= since_s)
            for frame in silent:
                del heard_s[frame]
            if heard_s:
                self._heard_s[stream] = heard_s
        if heard_s:
            self._look_later(stream)
        self._drop(stream, silent)


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

    def hear_message(self, name: str) -> None:
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
