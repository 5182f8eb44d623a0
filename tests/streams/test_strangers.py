"""A process that does not publish a stream can do nothing to it that lasts."""

import time
from collections.abc import Iterator

import pytest

from tests.builders import S, at, description, payload, x_of
from tests.buses import eventually
from tests.fakes import Lines
from tests.simulated_bus import Bus
from tests.streams.received import watch_of
from tfbus import Buffer, Node, StaticTransformBroadcaster, TransformBroadcaster, TransformListener
from tfbus.bus.query import Query
from tfbus.bus.retained import declare_retained_publisher
from tfbus.streams.info import StreamInfo
from tfbus.wire.codec import encode_message

FUTURE_NS = 2**62


class Scene:
    """A publisher of robot (dynamic) and post (static), a listener, and a stranger."""

    def __init__(self, bus: Bus) -> None:
        self.bus = bus
        self.sim = bus.node("sim")
        self.dynamic = TransformBroadcaster(self.sim)
        self.static = StaticTransformBroadcaster(self.sim)
        self.buffer = Buffer()
        receiver = bus.node("listener")
        self.log = Lines(receiver.log)
        self.listener = TransformListener(self.buffer, receiver)
        self.stranger = bus.node("stranger")
        self.static.send_transform(at(2, "post"))
        self.send(1)
        eventually(lambda: x_of(self.buffer, "world", "post") == 2)
        eventually(lambda: (self.send(1), x_of(self.buffer, "world", "robot") == 1)[1])
        eventually(lambda: len(self.stream().frames) == 2)

    def send(self, x: float) -> None:
        self.dynamic.send_transform(at(x, "robot", time.time_ns()))

    def stream(self) -> StreamInfo:
        return next(info for info in self.listener.streams() if info.name == "sim")

    def put(self, key: str, data: bytes) -> None:
        self.stranger.session.publisher(key).put(data)

    def reaches(self, x: float) -> bool:
        """Whether what the publisher sends now comes."""
        self.send(x)
        return x_of(self.buffer, "world", "robot") == x


@pytest.fixture
def scene(bus: Bus) -> Iterator[Scene]:
    scene = Scene(bus)
    yield scene
    scene.listener.close()


@pytest.mark.parametrize("key", ["tf/sim", "tf_static/sim"])
@pytest.mark.parametrize("ahead_ns", [FUTURE_NS, 1 * S])
def test_a_later_epoch_of_a_stranger_ends_nothing(scene: Scene, key: str, ahead_ns: int) -> None:
    """Only the session that publishes a stream begins an epoch of it; the others are counted."""
    epoch_ns = FUTURE_NS if ahead_ns == FUTURE_NS else time.time_ns() + ahead_ns
    publisher = scene.stranger.session.publisher(key)

    def is_counted() -> bool:
        publisher.put(payload([at(9, "post"), at(9, "robot", S)], epoch_ns))
        return scene.stream().disputed >= 3

    eventually(is_counted)
    assert (x_of(scene.buffer, "world", "robot"), x_of(scene.buffer, "world", "post")) == (1, 2)
    eventually(lambda: scene.reaches(3))
    assert scene.stream().epoch_ns == scene.sim.started_ns
    eventually(lambda: [line for line in scene.log.lines if "confirms it" in line])


def test_a_description_of_a_stranger_removes_nothing(scene: Scene) -> None:
    """Whatever it says of session and epoch, it is not from the session that publishes."""
    own = scene.sim.session.id
    for session, epoch in ((own, scene.sim.started_ns), ("", FUTURE_NS), (own, FUTURE_NS)):
        data = encode_message(description([], epoch=epoch, session=session))
        before = watch_of(scene.listener).rejected["sim"]

        def is_rejected(data: bytes = data, before: int = before) -> bool:
            scene.put("@tfbus/stream/sim", data)
            return watch_of(scene.listener).rejected["sim"] > before

        eventually(is_rejected)
        assert x_of(scene.buffer, "world", "post") == 2
    eventually(lambda: scene.reaches(3))


def test_a_publisher_of_the_same_key_from_the_future_is_refused(scene: Scene) -> None:
    """Not even with its own session, a description that is retained, and a token."""
    session = scene.stranger.session
    data = encode_message(description([], epoch=FUTURE_NS, session=session.id))
    publisher = declare_retained_publisher(session, "@tfbus/stream/sim")
    token = session.token("@tfbus/stream/sim")

    def is_rejected() -> bool:
        publisher.put(data)
        return watch_of(scene.listener).rejected["sim"] > 0

    eventually(is_rejected)
    assert x_of(scene.buffer, "world", "post") == 2
    eventually(lambda: scene.reaches(3))
    token.close()


@pytest.mark.parametrize("count", [1, 2])
def test_claims_of_other_sessions_hold_up_a_living_publisher_once(scene: Scene, count: int) -> None:
    """Each with a later epoch of its own session, and no message: once the publisher has shown that
    it lives, it keeps its stream. Its restart takes it as ever.
    """
    claimers = [scene.bus.node(f"claimer{n}").session for n in range(count)]
    publishers = [declare_retained_publisher(each, "@tfbus/stream/sim") for each in claimers]

    def claim() -> None:
        for claimer, publisher in zip(claimers, publishers, strict=True):
            data = description([], epoch=time.time_ns(), session=claimer.id)
            publisher.put(encode_message(data))

    def owner() -> str:
        return watch_of(scene.listener).streams()["sim"].owner

    def is_taken() -> bool:
        claim()
        return owner() == claimers[-1].id

    eventually(is_taken)
    eventually(lambda: scene.reaches(3) and owner() == scene.sim.session.id)
    owners: set[str] = set()
    for x in range(4, 7):
        before = watch_of(scene.listener).rejected["sim"]

        # Though it describes itself anew.
        scene.dynamic.send_transform(at(x, f"frame{x}", time.time_ns()))
        eventually(lambda x=x: f"frame{x}" in {child for _, child, _ in scene.stream().frames})

        def is_refused(before: int = before, x: int = x) -> bool:
            claim()
            owners.add(owner())
            return scene.reaches(x) and watch_of(scene.listener).rejected["sim"] > before

        eventually(is_refused)
    assert owners == {scene.sim.session.id}
    scene.sim.close()
    again = scene.bus.node("sim")
    scene.dynamic = TransformBroadcaster(again)
    eventually(lambda: scene.reaches(8) and owner() == again.session.id)


def test_a_stream_without_a_description_takes_no_frame_that_another_lists(scene: Scene) -> None:
    """Neither a dynamic nor a static one, as long as that one is there; its own are taken."""
    epoch_ns = time.time_ns()

    def send() -> None:
        now_ns = time.time_ns()
        stolen = [at(9, "post", now_ns), at(9, "robot", now_ns), at(7, "own", now_ns)]
        scene.put("tf/thief", payload(stolen, epoch_ns))
        scene.put("tf_static/thief", payload([at(9, "post"), at(8, "bolt")], epoch_ns))

    def is_met() -> bool:
        send()
        x_of_own = x_of(scene.buffer, "world", "own"), x_of(scene.buffer, "world", "bolt")
        return x_of_own == (7, 8)

    eventually(is_met)
    assert x_of(scene.buffer, "world", "post") == 2
    assert x_of(scene.buffer, "world", "robot") == 1
    eventually(lambda: scene.reaches(3))
    (thief,) = (info for info in scene.listener.streams() if info.name == "thief")
    assert thief.excluded >= 3
    eventually(lambda: (send(), any("does not list it" in line for line in scene.log.lines))[1])
    scene.sim.close()
    eventually(lambda: (send(), x_of(scene.buffer, "world", "robot") == 9)[1])


def test_the_publisher_undoes_what_came_before_it(bus: Bus) -> None:
    """A stranger that was there first has its way only until the publisher is known."""
    stranger: Node = bus.node("stranger")
    buffer = Buffer()
    with TransformListener(buffer, bus.node("listener")) as listener:

        def is_met() -> bool:
            stranger.session.publisher("tf/sim").put(payload([at(9, "robot", S)], FUTURE_NS))
            stranger.session.publisher("tf_static/sim").put(payload([at(9, "post")], FUTURE_NS))
            return x_of(buffer, "world", "robot") == 9 == x_of(buffer, "world", "post")

        eventually(is_met)
        sim = bus.node("sim")
        dynamic, static = TransformBroadcaster(sim), StaticTransformBroadcaster(sim)
        static.send_transform(at(2, "post"))

        def is_undone() -> bool:
            dynamic.send_transform(at(1, "robot", time.time_ns()))
            return x_of(buffer, "world", "robot") == 1 and x_of(buffer, "world", "post") == 2

        eventually(is_undone)
        assert [info.epoch_ns for info in listener.streams() if info.name == "sim"] == [
            sim.started_ns
        ]


def test_a_name_that_cannot_be_shown_is_ignored_wherever_it_stands(scene: Scene) -> None:
    """A stream of such a name is no stream, and a frame of such a name no frame."""
    evil = "evil%1B[31m%0A[INFO]"
    session = scene.stranger.session
    token = session.token(f"@tfbus/stream/{evil}")
    publisher = declare_retained_publisher(session, "@tfbus/stream/other")
    rows = [("world", "a\x1b[31m", False), ("world", "fine", True)]

    def is_met() -> bool:
        for key in ("tf", "tf_static"):
            scene.put(f"{key}/{evil}", payload([at(1, "ghost")]))
        publisher.put(encode_message(description(rows, session=session.id)))
        return any(info.name == "other" and info.frames for info in scene.listener.streams())

    eventually(is_met)
    eventually(lambda: len([line for line in scene.log.lines if "cannot be shown" in line]) == 2)
    infos = {info.name: info for info in scene.listener.streams()}
    assert infos.keys() == {"sim", "other"}
    assert infos["other"].frames == (("world", "fine", True),)
    assert "ghost" not in scene.buffer.frames()
    assert all(line.isprintable() for line in scene.log.lines)
    token.close()


def test_a_publisher_that_cannot_sign_what_it_sends_is_asked(bus: Bus) -> None:
    """Its plain descriptions are taken by its answers, which Zenoh signs."""
    session, key = bus.node("plain").session, "@tfbus/stream/plain"
    told = [encode_message(description([], session=session.id))]

    def answer(query: Query) -> None:
        query.answer(key, told[-1])
        query.close()

    session.queryable(f"{key}/@adv/pub/**", answer)
    token = session.token(key)
    with TransformListener(Buffer(), bus.node("listener")) as listener:
        for child in ("a", "b"):
            row = ("world", child, False)
            told.append(encode_message(description([row], session=session.id)))

            def is_known(row: tuple[str, str, bool] = row) -> bool:
                session.publisher(key).put(told[-1])
                return any(row in info.frames for info in listener.streams())

            eventually(is_known)
            eventually(lambda: watch_of(listener).streams()["plain"].confirmed)
    token.close()
