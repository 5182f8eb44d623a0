"""Prints the frames that all streams of the bus send, without tfbus: dynamic, static and gone.

    python examples/wire/listen.py

Start `tfbus launch demo`, or talk.py, before or after it. It prints a frame when it comes, and
each dynamic one once a second. Ctrl-C ends it. Needs eclipse-zenoh and msgpack only; each comment
names a section of docs/reference/wire.md.
"""

import queue
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

from tfbus_wire import (
    NO_NUMBERS,
    Description,
    Message,
    Numbers,
    Transform,
    chunk,
    decode_description,
    decode_transforms,
    is_cdr,
    name_of,
    open_session,
    stream_of,
)
from zenoh import ConsolidationMode, Reply, ReplyKeyExpr, Sample, SampleKind, Session, ext

MOST_HELD = 100  # messages of a stream that wait for its description


@dataclass
class Frame:
    """Where a frame is, by the last message that said so."""

    stream: str
    static: bool
    transform: Transform


@dataclass
class Stream:
    """What is known of a stream."""

    epoch: int | None = None
    gone: bool = False
    # By the session that sent it; those that are not from the session that they name as of ""
    descriptions: dict[str, Description] = field(default_factory=dict)
    held: list[tuple[bool, Message]] = field(default_factory=list)
    numbers: Numbers = NO_NUMBERS
    unnamed: list[tuple[str, bytes]] = field(default_factory=list)  # their keys and payloads
    smaller_since_s: float | None = None


class Listener:
    """The frames of all streams. One thread reads what arrived, so it needs no locks."""

    def __init__(self, session: Session):
        self.session = session
        self.streams: dict[str, Stream] = {}
        self.frames: dict[str, Frame] = {}  # by child
        self.arrived: queue.SimpleQueue[tuple[Callable[[Any], None], Any]] = queue.SimpleQueue()
        put = self.arrived.put
        # How messages are sent: an advanced subscriber also receives what is retained. Without one,
        # query tf_static/<stream>/@adv/pub/** when the token comes, as read_description() does.
        self.declared = [
            ext.declare_advanced_subscriber(
                session,
                "tf_static/*",
                lambda sample: put((self.on_transforms, sample)),
                history=ext.HistoryConfig(max_samples=1, detect_late_publishers=True),
                recovery=ext.RecoveryConfig(periodic_queries=None, heartbeat=True),
            ),
            session.declare_subscriber("tf/**", lambda sample: put((self.on_transforms, sample))),
            session.declare_subscriber(
                "@tfbus/stream/*", lambda sample: put((self.on_description, sample))
            ),
            session.liveliness().declare_subscriber(
                "@tfbus/stream/*", lambda sample: put((self.on_token, sample)), history=True
            ),
        ]

    def run(self) -> None:
        """Read what arrives, and print the dynamic frames once a second; never returns."""
        next_s = time.monotonic() + 1.0
        while True:
            with suppress(queue.Empty):
                read, what = self.arrived.get(timeout=max(0.0, next_s - time.monotonic()))
                read(what)
            if time.monotonic() >= next_s:
                next_s += 1.0
                for frame in self.frames.values():
                    if not frame.static and not self.streams[frame.stream].gone:
                        say(line_of(frame))

    # --- Streams and nodes

    def on_token(self, token: Sample) -> None:
        name = name_of(str(token.key_expr).split("/")[2])
        stream = self.streams.setdefault(name, Stream())
        stream.gone = token.kind == SampleKind.DELETE
        if stream.gone:
            say(f"stream {name!r} is gone")
            # Epochs: what comes after a lost token is a new publisher, whatever its epoch is
            stream.descriptions.clear()
            stream.epoch = None
            return
        say(f"stream {name!r} is there")
        self.read_description(name)
        self.read_history(name)

    def read_description(self, name: str) -> None:
        """Query the description of a stream, which is retained."""

        def on_reply(reply: Reply) -> None:
            if reply.ok:
                self.arrived.put((self.on_description_reply, reply))

        self.session.get(
            f"@tfbus/stream/{chunk(name)}/@adv/pub/**", on_reply, accept_replies=ReplyKeyExpr.ANY
        )

    def on_description(self, sample: Sample) -> None:
        source = sample.source_info
        self.describe(sample, str(source.source_id.zid) if source else "")

    def on_description_reply(self, reply: Reply) -> None:
        assert reply.ok  # others are not put into the queue
        self.describe(reply.ok, str(reply.replier_id.zid) if reply.replier_id else "")

    def describe(self, sample: Sample, session: str) -> None:
        name = name_of(str(sample.key_expr).split("/")[2])
        try:
            new = decode_description(sample.payload.to_bytes())
        except ValueError as error:
            say(f"refused the description of {name!r}: {error}")
            return
        stream = self.streams.setdefault(name, Stream())
        # Epochs: one that is not from the session that it names counts only before all others
        if new.session != session or not session:
            session = ""
        if not session and stream.descriptions.keys() - {""}:
            return
        if session:
            stream.descriptions.pop("", None)
        old = stream.descriptions.get(session)
        stream.descriptions[session] = new
        if old is None:
            say(f"stream {name!r} is of {new.node!r} on {new.host!r}, {len(new.frames)} frames")
        elif (old.epoch, old.node, old.pid) == (new.epoch, new.node, new.pid) or (
            old.epoch < new.epoch and (old.node, old.pid) == (new.node, new.pid)
        ):
            # Streams and nodes: what was listed, and is not any more, was removed
            still = {child for _, child, _ in new.frames}
            self.forget(child for _, child, _ in old.frames if child not in still)
        stream.numbers = new.numbers
        held, stream.held = stream.held, []
        for static, message in held:
            self.take(name, static, message)
        unnamed, stream.unnamed = stream.unnamed, []
        for key, payload in unnamed:
            self.on_payload(key, payload, is_held=True)

    # --- History

    def read_history(self, name: str) -> None:
        """Query the dynamic transforms of the last second."""

        def on_reply(reply: Reply) -> None:
            if reply.ok:
                self.arrived.put((self.on_transforms, reply.ok))

        self.session.get(
            f"tf/{chunk(name)}/**?last_s=1", on_reply, consolidation=ConsolidationMode.NONE
        )

    # --- A message of transforms

    def on_transforms(self, sample: Sample) -> None:
        self.on_payload(str(sample.key_expr), sample.payload.to_bytes())

    def on_payload(self, key: str, payload: bytes, *, is_held: bool = False) -> None:
        name = stream_of(key)
        if not name or is_cdr(payload):
            return
        static = key.startswith("tf_static/")
        stream = self.streams.setdefault(name, Stream())
        try:
            message = decode_transforms(payload, None if static else stream.numbers)
        except ValueError as error:
            say(f"refused a message on {key!r}: {error}")
            return
        for reason in message.refused:
            say(f"refused a transform on {key!r}: {reason}")
        if message.unnamed and not is_held:
            # Frames by numbers: hold it, take its other rows, and query the description
            say(f"no names yet for the numbers {message.unnamed[:9]} on {key!r}")
            stream.unnamed = [*stream.unnamed[1 - MOST_HELD :], (key, payload)]
            self.read_description(name)
        self.take(name, static, message)

    def take(self, name: str, static: bool, message: Message) -> None:
        stream = self.streams.setdefault(name, Stream())
        if not self.counts(name, stream, static, message):
            return
        if static:
            # The message replaces the one before
            still = {child for _, child, _, _ in message.transforms}
            self.forget(
                child
                for child, frame in self.frames.items()
                if frame.stream == name and frame.static and child not in still
            )
        for transform in message.transforms:
            self.set_frame(Frame(name, static, transform))

    def set_frame(self, frame: Frame) -> None:
        parent, child, stamp_ns, _ = frame.transform
        # What to ignore and what to refuse
        above: str | None = parent
        while above is not None:
            if above == child:
                say(f"refused {parent!r} -> {child!r} of {frame.stream!r}: it would close a loop")
                return
            above = self.frames[above].transform[0] if above in self.frames else None
        old = self.frames.get(child)
        if old and not old.static and not frame.static and stamp_ns < old.transform[2]:
            return  # a buffer would keep it, for lookups in the past
        self.frames[child] = frame
        if old is None or (frame.static and old.transform[::3] != frame.transform[::3]):
            say(line_of(frame))

    def forget(self, children: Iterable[str]) -> None:
        for child in list(children):
            if self.frames.pop(child, None):
                say(f"frame {child!r} was removed")

    # --- Epochs

    def counts(self, name: str, stream: Stream, static: bool, message: Message) -> bool:
        """Whether a message is of the epoch that counts; begins the epoch where it is a new one."""
        described = {
            description.epoch for session, description in stream.descriptions.items() if session
        }
        if described and message.epoch not in described:
            if len(stream.held) < MOST_HELD:
                stream.held.append((static, message))
            self.read_description(name)
            return False
        if not described and stream.epoch and message.epoch > time.time_ns() + 60_000_000_000:
            return False
        if stream.epoch is not None and message.epoch < stream.epoch:
            # Late, unless two processes send the stream and the one of the larger epoch is silent
            now_s = time.monotonic()
            if stream.smaller_since_s is None:
                stream.smaller_since_s = now_s
            if now_s - stream.smaller_since_s < 1.0:
                return False
        elif stream.epoch == message.epoch:
            stream.smaller_since_s = None
            return True
        if stream.epoch is not None:
            say(f"stream {name!r} restarted")
        stream.epoch = message.epoch
        stream.smaller_since_s = None
        self.forget(
            child
            for child, frame in self.frames.items()
            if frame.stream == name and not frame.static
        )
        return True


def line_of(frame: Frame) -> str:
    """A frame as one line."""
    parent, child, _, pose = frame.transform
    kind = "static" if frame.static else "dynamic"
    xyz = " ".join(f"{part:.3f}" for part in pose[:3])
    quat = " ".join(f"{part:.3f}" for part in pose[3:])
    return f"{parent} -> {child}: {xyz}, {quat} ({kind}, {frame.stream!r})"


def say(text: str) -> None:
    print(text, flush=True)


def main() -> None:
    with suppress(KeyboardInterrupt), open_session() as session:
        Listener(session).run()


if __name__ == "__main__":
    main()
