"""The streams whose descriptions a watch of a fleet wants: of most robots it reads nothing."""

from collections.abc import Callable, Set

from tfbus.bus.query import Answer, AskUntil, Pauses
from tfbus.bus.session import Session
from tfbus.listen.queries import ask_who_lists
from tfbus.runtime.executor import Executor
from tfbus.wire.descriptions import StreamDescription
from tfbus.wire.keys import ALL_STREAMS_EVERYWHERE, namespace_of

# Where no stream lists a frame nobody answers, as if the question were lost: it is repeated.
_PAUSES = Pauses((0.4, 2.0), lost_after_s=0.5)
# New tokens are gathered for this time; more of them than these are asked by one question for all.
_GATHERED_FOR_S = 0.1
_FEW = 20

_WHAT = "streams that list a frame"


class WantedStreams:
    """The streams in some namespaces, and all streams that list one of some frames.

    Each stream that answers a question whether it lists them is given to `on_answer(answer)`, which
    may call `finds`. All that runs on the executor's thread. It remembers streams that `finds` has
    found until `lets_go`, or `forget`.
    """

    def __init__(
        self, session: Session, executor: Executor, on_answer: Callable[[Answer], None]
    ) -> None:
        self._session = session
        self._executor = executor
        self._on_answer = on_answer
        self._namespaces: frozenset[str] = frozenset()
        self.frames: frozenset[str] = frozenset()
        self._found: set[str] = set()
        # Tokens that are about to be asked whether they list one of the frames.
        self._met: dict[str, None] = {}

    def __contains__(self, key: str) -> bool:
        return key in self._found or namespace_of(key) in self._namespaces

    def want(self, namespaces: Set[str], frames: Set[str]) -> frozenset[str]:
        """Want these from now on, and no others; returns the namespaces that are new."""
        new, sought = frozenset(namespaces) - self._namespaces, frozenset(frames) - self.frames
        self._namespaces, self.frames = frozenset(namespaces), frozenset(frames)
        if sought:
            self._ask(ALL_STREAMS_EVERYWHERE, sought)
        return new

    def meet(self, key: str) -> None:
        """A token is there now that is not wanted so far."""
        if self.frames:
            self._met[key] = None
            if len(self._met) == 1:
                self._executor.after(_GATHERED_FOR_S, self._ask_met)

    def finds(self, key: str, description: StreamDescription) -> bool:
        """Whether a stream that was not wanted so far is, as it describes itself."""
        is_found = key not in self and any(row[1] in self.frames for row in description.frames)
        if is_found:
            self._found.add(key)
        return is_found

    def lets_go(self, key: str, description: StreamDescription) -> bool:
        """Whether a stream that describes itself so is wanted no longer."""
        self._found.discard(key)
        return key not in self and not self.finds(key, description)

    def forget(self, key: str) -> None:
        """A stream is long gone."""
        self._found.discard(key)

    def _ask_met(self) -> None:
        met = [*self._met]
        self._met.clear()
        for keys in met if len(met) <= _FEW else [ALL_STREAMS_EVERYWHERE]:
            self._ask(keys, self.frames)

    def _ask(self, keys: str, frames: frozenset[str]) -> None:
        def ask(turn: int, on_end: Callable[[], None]) -> None:
            ask_who_lists(self._session, keys, frames, on_answer, on_end)

        def on_answer(answer: Answer) -> None:
            if answer.refusal is None:
                self._executor.submit(_WHAT, lambda: self._on_answer(answer))

        AskUntil(
            self._executor, _WHAT, _PAUSES, ask=ask, is_settled=lambda: keys in self._found
        ).start()
