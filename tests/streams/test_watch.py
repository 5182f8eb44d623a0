"""The streams on the bus: their tokens and descriptions, without their data."""

from collections.abc import Callable, Iterator
from typing import Any

import pytest

from tests.buses import eventually
from tests.live_bus import free_port
from tests.simulated_bus import Bus
from tests.streams.received import questions_for
from tfbus import (
    Node,
    NodeSettings,
    Transform,
    TransformBroadcaster,
    TransformStamped,
)
from tfbus.bus.network_session import BytesPublisher
from tfbus.bus.query import Answer, Pauses
from tfbus.bus.retained import declare_retained_publisher
from tfbus.bus.session import Session
from tfbus.streams import description_queries, stream_states
from tfbus.streams.info import StreamState
from tfbus.streams.watch import StreamWatch
from tfbus.wire.codec import encode_message
from tfbus.wire.descriptions import StreamDescription


def ask_after(monkeypatch: pytest.MonkeyPatch, pauses: Pauses) -> None:
    """Watches ask for descriptions after these pauses from now on."""
    monkeypatch.setattr(description_queries, "_PAUSES", pauses)


class Watching:
    """A watch and the changes that it reported."""

    def __init__(self, node: Node, *, everywhere: bool = False) -> None:
        self.changes: list[StreamState] = []
        self.watch = StreamWatch(
            node.session, self.changes.append, everywhere=everywhere, log=node.log
        )

    def alive(self) -> list[str]:
        return sorted(name for name, state in self.watch.streams().items() if state.alive)

    def described(self, name: str) -> StreamDescription | None:
        state = self.watch.streams().get(name)
        return state.description if state else None


@pytest.fixture
def watching(bus: Bus) -> Iterator[Watching]:
    watching = Watching(bus.node("watcher"))
    yield watching
    watching.watch.close()


def broadcast(node: Node, child: str = "robot", stream: str | None = None) -> Callable[[], None]:
    broadcaster = TransformBroadcaster(node, stream=stream)
    return lambda: broadcaster.send_transform(
        TransformStamped(1, "world", child, Transform.identity())
    )


def put_until(publisher: BytesPublisher, payload: bytes, condition: Callable[[], bool]) -> None:
    """Put a payload until it comes: without a token it is not asked for if it was put early."""

    def put() -> bool:
        publisher.put(payload)
        return condition()

    eventually(put)


def test_streams_are_known_without_their_data(bus: Bus, watching: Watching) -> None:
    """Publishers and their frames are known from tokens and descriptions."""
    node = bus.node("sim")
    broadcast(node, stream="arm/left *")()
    report = eventually(lambda: watching.described("arm/left *"))
    eventually(lambda: watching.alive() == ["arm/left *"])
    assert (report.node, report.epoch) == ("/sim", node.started_ns)
    assert report.frames == (("world", "robot", False),)
    assert watching.changes[-1] == watching.watch.streams()["arm/left *"]
    node.close()
    eventually(lambda: watching.alive() == [])
    assert watching.described("arm/left *") is not None


def test_a_later_watch_knows_the_same(bus: Bus) -> None:
    """A watch that starts after the publisher knows its stream."""
    broadcast(bus.node("sim"))()
    late = Watching(bus.node("late"))
    eventually(lambda: late.described("sim"))
    eventually(lambda: late.alive() == ["sim"])


def test_streams_of_all_namespaces_can_be_watched(bus: Bus, watching: Watching) -> None:
    """Outside all namespaces a watch can know the streams of each, by full names."""
    everywhere = Watching(bus.node("everywhere"), everywhere=True)
    broadcast(bus.node("sim", namespace="robot7"))()
    broadcast(bus.node("sim"))()
    eventually(lambda: everywhere.alive() == ["robot7/sim", "sim"])
    report = eventually(lambda: everywhere.described("robot7/sim"))
    assert report.node == "/robot7/sim"
    eventually(lambda: watching.alive() == ["sim"])


def test_a_token_that_comes_back_is_not_taken_for_the_former_process(
    bus: Bus, watching: Watching
) -> None:
    """A node of the same name that has sent nothing yet is not the former one."""
    first = bus.node("sim")
    broadcast(first)()
    eventually(lambda: watching.described("sim"))
    eventually(lambda: watching.alive() == ["sim"])
    first.close()
    eventually(lambda: watching.alive() == [])
    before = len(watching.changes)
    second = bus.node("sim")
    broadcast(second, "arm")()
    eventually(lambda: watching.alive() == ["sim"])
    report = [state.description for state in watching.changes[before:] if state.alive]
    assert {description.epoch for description in report if description} == {second.started_ns}


def test_a_token_that_comes_back_to_the_same_process_is_taken(bus: Bus, watching: Watching) -> None:
    """A publisher whose link was down is back with its last description."""
    node = bus.node("sim")
    stranger = bus.node("stranger")
    publisher = declare_retained_publisher(stranger.session, "@tfbus/stream/lone")
    for name, session in (("/sim", node.session.id), ("/other", "?")):
        description = StreamDescription(1, name, 1, (("world", "robot", False),), session=session)
        put_until(
            publisher,
            encode_message(description),
            lambda description=description: watching.described("lone") == description,
        )
        for _ in range(2):
            token = stranger.session.token("@tfbus/stream/lone")
            eventually(lambda: watching.alive() == ["lone"])
            token.close()
            eventually(lambda: watching.alive() == [])


def test_a_missing_description_is_asked_for_again_and_again(
    bus: Bus, watching: Watching, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Until the stream is gone."""
    asked: list[str] = []

    def ask(session: Session, key: str, turn: int, on_answer: Any, on_end: Any) -> None:
        asked.append(key)
        on_end()

    monkeypatch.setattr(description_queries, "description_question", questions_for(ask))
    ask_after(monkeypatch, Pauses((0.001, 0.002), forever=True))
    session = bus.node("sim").session
    first = session.token("@tfbus/stream/first")
    eventually(lambda: len(asked) > 20)
    first.close()
    eventually(lambda: watching.alive() == [])
    before = len(asked)
    second = session.token("@tfbus/stream/second")
    eventually(lambda: asked.count("@tfbus/stream/second") > 20)
    second.close()
    assert asked[before:].count("@tfbus/stream/first") <= 1


def test_a_lost_question_is_not_waited_for(
    bus: Bus, watching: Watching, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Others are asked while one is open, and the first answer ends them all."""
    questions: list[Callable[[Answer], None]] = []
    ends: list[Callable[[], None]] = []

    def ask(session: Session, key: str, turn: int, on_answer: Any, on_end: Any) -> None:
        questions.append(on_answer)
        ends.append(on_end)

    monkeypatch.setattr(description_queries, "description_question", questions_for(ask))
    impatient = Pauses((0.001,), forever=True, lost_after_s=0.001)
    ask_after(monkeypatch, impatient)
    lone = bus.node("sim").session.token("@tfbus/stream/lone")
    eventually(lambda: len(questions) >= 3)
    key = "@tfbus/stream/lone"
    questions[0](Answer(key, encode_message(StreamDescription(1, "/sim", 7, ()))))
    ends[0]()
    assert eventually(lambda: watching.described("lone")).epoch == 7
    asked = len(questions)
    ask_after(monkeypatch, Pauses((60.0,), lost_after_s=60.0))
    other = bus.node("other").session.token("@tfbus/stream/other")
    # The question about the other comes after any further one about the first.
    eventually(lambda: watching.alive() == ["lone", "other"] and len(questions) > asked)
    assert len(questions) <= asked + 2
    other.close()
    lone.close()


def test_a_token_that_comes_and_goes_leads_to_one_question_at_a_time(
    bus: Bus, watching: Watching, monkeypatch: pytest.MonkeyPatch
) -> None:
    """However often a token comes back, only the questions about the last one go on."""
    others: list[str] = []
    ends: list[Callable[[], None]] = []

    def ask(session: Session, key: str, turn: int, on_answer: Any, on_end: Any) -> None:
        if key == "@tfbus/stream/lone":
            ends.append(on_end)
        elif key == "@tfbus/stream/other":
            others.append(key)
            on_end()

    monkeypatch.setattr(description_queries, "description_question", questions_for(ask))
    ask_after(monkeypatch, Pauses((0.001,), forever=True))
    session = bus.node("sim").session
    for number in range(8):
        token = session.token("@tfbus/stream/lone")
        eventually(lambda number=number: len(ends) > number)
        if number < 7:
            token.close()
            eventually(lambda: watching.alive() == [])
    begun = tuple(ends)
    for end in begun:
        end()
    # This one is asked about again after the same pause, so after all others.
    other = session.token("@tfbus/stream/other")
    eventually(lambda: len(others) >= 2)
    assert len(ends) == len(begun) + 1
    token.close()
    other.close()


def test_a_description_that_cannot_be_read_is_asked_for_once(
    bus: Bus, watching: Watching, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An answer that is no description ends the questions, until the token comes again."""
    asked: list[str] = []

    def ask(session: Session, key: str, turn: int, on_answer: Any, on_end: Any) -> None:
        asked.append(key)
        if key == "@tfbus/stream/broken":
            on_answer(Answer(key, b"nonsense"))
        on_end()

    monkeypatch.setattr(description_queries, "description_question", questions_for(ask))
    ask_after(monkeypatch, Pauses((0.001,), forever=True))
    session = bus.node("sim").session
    for times in (1, 2):
        broken = session.token("@tfbus/stream/broken")
        eventually(lambda: watching.alive() == ["broken"])
        eventually(lambda times=times: asked.count("@tfbus/stream/broken") == times)
        other = session.token("@tfbus/stream/other")
        before = asked.count("@tfbus/stream/other")
        eventually(lambda before=before: asked.count("@tfbus/stream/other") >= before + 2)
        assert asked.count("@tfbus/stream/broken") == times
        assert watching.watch.rejected.total() == times
        other.close()
        broken.close()
        eventually(lambda: watching.alive() == [])


def test_a_description_that_cannot_be_read_is_counted(bus: Bus, watching: Watching) -> None:
    """Bytes that are no description are counted, and the next one is taken."""
    node = bus.node("sim")
    publisher = declare_retained_publisher(node.session, "@tfbus/stream/sim")
    put_until(publisher, b"nonsense", lambda: bool(watching.watch.rejected))
    description = StreamDescription(1, "/sim", 1, ())
    put_until(
        publisher, encode_message(description), lambda: watching.described("sim") == description
    )


def test_what_was_counted_of_a_stream_is_forgotten_with_it(
    bus: Bus, monkeypatch: pytest.MonkeyPatch
) -> None:
    """However many names a peer makes up."""
    monkeypatch.setattr(stream_states, "MOST_GONE", 2)
    watching, session = Watching(bus.node("watcher")), bus.node("sim").session
    for number in range(5):
        key = f"@tfbus/stream/made_up{number}"
        token = session.token(key)
        publisher = declare_retained_publisher(session, key)
        count = watching.watch.rejected
        put_until(
            publisher, b"nonsense", lambda key=key, count=count: count[key.rpartition("/")[2]]
        )
        token.close()
        eventually(lambda: watching.alive() == [])
    assert watching.watch.rejected.keys() - {""} == {"made_up3", "made_up4"}


@pytest.mark.real
def test_publishers_that_join_later_are_described_too(bus: Bus) -> None:
    """A publisher whose link opens after the watch starts is known with its description."""
    meeting_point = f"tcp/127.0.0.1:{free_port()}"
    config = str(bus.quick_config)
    with Node(settings=NodeSettings("early", config=config, connect=(meeting_point,))) as early:
        broadcast(early)()
        listens = NodeSettings("watcher", config=config, listen=(meeting_point,))
        with Node(settings=listens) as watcher:
            watching = Watching(watcher)
            report = eventually(lambda: watching.described("early"))
            assert report.frames == (("world", "robot", False),)
            eventually(lambda: watching.alive() == ["early"])
            watching.watch.close()
