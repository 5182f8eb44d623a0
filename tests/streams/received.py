"""A stream as tests receive it, and a buffer to look into."""

import logging
from collections.abc import Callable
from functools import partial
from typing import Any

from tests.builders import S, payload, x_of
from tfbus import Buffer, TransformListener, TransformStamped
from tfbus.bus.session import Session
from tfbus.streams.reception import DynamicReception, StreamReception
from tfbus.streams.registry import Registry
from tfbus.streams.stream_facts import ReceptionHooks
from tfbus.streams.watch import StreamWatch
from tfbus.wire.transforms import TransformReader


def watch_of(listener: TransformListener) -> StreamWatch:
    """How a listener knows its streams: whose descriptions it took, and which it rejected."""
    return listener._watch


def registry_of(listener: TransformListener) -> Registry:
    """What a listener keeps of each stream."""
    return listener._registry


def receive(listener: TransformListener, key: str, data: bytes) -> None:
    """A message comes, and has been dealt with when this returns."""
    listener._on_message(key, data)


class PutQuestion:
    """A question about `what` that calls `ask(session, *what, on_answer, on_end)`."""

    def __init__(self, ask: Callable[..., object], *what: Any) -> None:
        self._ask = ask
        self._what = what

    def ask(self, session: Session, on_answer: Any, on_end: Any) -> None:
        self._ask(session, *self._what, on_answer, on_end)


def questions_for(ask: Callable[..., object]) -> Callable[..., PutQuestion]:
    """Makes questions that `ask` gets in the place of the bus."""
    return partial(PutQuestion, ask)


def appear(stream: StreamReception) -> None:
    """The publisher of a stream is there, for the first time or again, with the list it had."""
    stream.arrive()
    stream.marks.update()


class Takeovers(ReceptionHooks):
    """Notes which stream's other process counts from which epoch on."""

    def __init__(self, noted: list[tuple[str, int]]) -> None:
        super().__init__(logging.getLogger("test"))
        self._noted = noted

    def on_takeover(self, stream: str, epoch_ns: int) -> None:
        self._noted.append((stream, epoch_ns))


class Received:
    """A stream as it is received into a buffer of its own."""

    def __init__(self, buffer: Any = None) -> None:
        self.buffer = Buffer() if buffer is None else buffer
        self.time_s = 0.0
        self.now_ns = 9 * S
        self.taken_over: list[tuple[str, int]] = []
        self.stream = StreamReception(
            "sim",
            self.buffer,
            logging.getLogger("test"),
            lambda: self.now_ns,
            TransformReader(),
            around=Takeovers(self.taken_over),
            now_s=lambda: self.time_s,
        )
        self.key = DynamicReception(self.stream)

    def send(
        self, *transforms: TransformStamped, epoch_ns: int = 1, seq: int | None = None
    ) -> None:
        self.key.receive(payload(transforms, epoch_ns, seq))

    def send_static(self, *transforms: TransformStamped, epoch_ns: int = 1) -> None:
        self.stream.statics.receive(payload(transforms, epoch_ns))

    def describe(self, *children: str, epoch_ns: int = 1) -> None:
        self.stream.describe(epoch_ns, frozenset(children))

    def gone(self) -> list[str]:
        return [info.name for info in self.buffer.all_frames() if info.gone]

    def x_of(self, child: str) -> float | None:
        return x_of(self.buffer, "world", child)
