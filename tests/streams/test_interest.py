"""Listeners that read only the streams that the lookups of their buffer need."""

import asyncio
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from signal import SIGKILL

import pytest

from tests.builders import description, live_stream, x_of
from tests.buses import eventually
from tests.processes.publishers import launch, start
from tests.simulated_bus import Bus
from tfbus import (
    Buffer,
    ConnectivityException,
    Fleet,
    FrameInfo,
    InvalidArgumentException,
    LookupException,
    Node,
    StaticTransformBroadcaster,
    TimeoutException,
    Transform,
    TransformBroadcaster,
    TransformListener,
    TransformStamped,
)
from tfbus.base.errors import BusError
from tfbus.bus.network_session import Declaration
from tfbus.streams.interest import KEPT_S, DescribedEdge, DescribedTree, Interest

PATIENCE_S = 20.0


def edge(parent: str, child: str, x: float = 1.0) -> TransformStamped:
    """`child` x metres ahead of its parent, now."""
    return TransformStamped(time.time_ns(), parent, child, Transform((x, 0, 0)))


class Sender:
    """A node that sends one edge at 50 Hz, with the stamp of each moment."""

    def __init__(self, bus: Bus, name: str, parent: str, child: str, x: float = 1.0):
        self.parent, self.child, self.x = parent, child, x
        node = bus.node(name)
        self.broadcaster = TransformBroadcaster(node)
        node.create_timer(0.02, self._send)

    def _send(self) -> None:
        if self.child:
            self.broadcaster.send_transform(edge(self.parent, self.child, self.x))


@pytest.fixture
def buffer() -> Buffer:
    return Buffer()


@pytest.fixture
def listener(receiver: Node, buffer: Buffer) -> Iterator[TransformListener]:
    with TransformListener(buffer, receiver, reads="needed") as listener:
        yield listener


def received(listener: TransformListener) -> dict[str, int]:
    """The count of messages of each stream that has a description."""
    return {info.name: info.messages for info in listener.streams() if info.frames}


def test_only_what_a_lookup_needs_is_read(
    bus: Bus, buffer: Buffer, listener: TransformListener
) -> None:
    """A lookup with a timeout works the first time, and no message comes of streams that it does
    not need, though their frames are known.
    """
    start(bus, "slam", "--moving", "map:odom")
    start(bus, "wheels", "--moving", "odom:base", "--x", "2")
    start(bus, "model", "--static", "base:lidar", "--x", "4")
    start(bus, "arm", "--moving", "base:arm", "--static", "arm:tool")
    eventually(lambda: set(received(listener)) == {"slam", "wheels", "model", "arm"})
    whole = buffer.lookup_transform("odom", "lidar", timeout_s=PATIENCE_S)
    assert whole.transform.x == pytest.approx(6)
    eventually(lambda: received(listener)["wheels"] > 20)
    assert {stream for stream, count in received(listener).items() if count} == {"wheels", "model"}
    assert buffer.frames() == ["base", "lidar", "odom"]


def test_without_a_timeout_the_error_says_what_is_read_now(
    bus: Bus, buffer: Buffer, listener: TransformListener
) -> None:
    """The first lookup without a timeout says what is read from now on; a later one answers."""
    broadcaster = TransformBroadcaster(bus.node("wheels"))
    broadcaster.send_transform(edge("odom", "base"))
    eventually(lambda: received(listener) == {"wheels": 0})
    with pytest.raises(LookupException) as caught:
        buffer.lookup_transform("odom", "base")
    assert "reading stream 'wheels'" in caught.value.fact
    assert caught.value.waiting_by == "timeout_s"
    assert caught.value.frame == "odom"

    def is_there() -> bool:
        broadcaster.send_transform(edge("odom", "base"))
        return x_of(buffer, "odom", "base") == 1

    eventually(is_there)


def test_an_unknown_name_is_compared_with_those_that_streams_list(
    bus: Bus, buffer: Buffer, listener: TransformListener
) -> None:
    """The frames on the bus that are not read are among them."""
    start(bus, "wheels", "--moving", "odom:base_link")
    eventually(lambda: received(listener) == {"wheels": 0})
    with pytest.raises(LookupException, match=r"'base_lnk'; .*'base_link'"):
        buffer.lookup_transform("odom", "base_lnk")


def test_frames_of_two_trees_are_not_connected(
    bus: Bus, buffer: Buffer, listener: TransformListener
) -> None:
    """The error names the roots of both by the streams' descriptions."""
    start(bus, "left", "--moving", "world:a", "--moving", "a:b")
    start(bus, "right", "--moving", "floor:c")
    eventually(lambda: len(received(listener)) == 2)
    with pytest.raises(ConnectivityException) as caught:
        buffer.lookup_transform("b", "c")
    assert (caught.value.target_root, caught.value.source_root) == ("world", "floor")
    with pytest.raises(TimeoutException):
        buffer.lookup_transform("b", "c", timeout_s=0.05)


def test_a_lookup_may_wait_for_publishers_to_start(
    bus: Bus, buffer: Buffer, listener: TransformListener
) -> None:
    """A waiting lookup is answered by publishers that start later, with asyncio too."""

    async def look() -> TransformStamped:
        task = asyncio.create_task(buffer.wait_for_transform("map", "base", timeout_s=PATIENCE_S))
        await asyncio.sleep(0)
        launch(bus, "late", "--moving", "map:base")
        return await task

    assert asyncio.run(look()).child_frame_id == "base"


def test_the_path_follows_a_frame_to_another_parent(
    bus: Bus, buffer: Buffer, listener: TransformListener
) -> None:
    """A cup that moves from the table to the hand makes the stream of the hand needed."""
    start(bus, "table", "--static", "room:table", "--x", "1")
    start(bus, "robot", "--moving", "room:hand", "--x", "5")
    cup = Sender(bus, "cup", "table", "cup", 0.25)
    buffer.lookup_transform("room", "cup", timeout_s=PATIENCE_S)
    assert x_of(buffer, "room", "cup") == 1.25
    eventually(lambda: received(listener).get("robot") == 0)
    cup.parent = "hand"
    eventually(lambda: x_of(buffer, "room", "cup") == 5.25)


def test_the_path_follows_a_frame_to_another_stream(
    bus: Bus, buffer: Buffer, listener: TransformListener
) -> None:
    """A frame that one publisher removes and another sends is read from the other."""
    first = Sender(bus, "first", "map", "base", 1)
    second = Sender(bus, "second", "map", "other", 2)
    assert buffer.lookup_transform(
        "map", "base", timeout_s=PATIENCE_S
    ).transform.x == pytest.approx(1)
    eventually(lambda: received(listener).get("second") == 0)
    first.child = ""
    first.broadcaster.remove("base")
    second.child = "base"
    eventually(lambda: x_of(buffer, "map", "base") == 2)
    assert buffer.frame("base").authority == "second"


def test_a_killed_publisher_is_read_again_when_restarted(
    bus: Bus, buffer: Buffer, listener: TransformListener
) -> None:
    """Frames of a gone publisher are marked; the restarted one is read."""
    first = start(bus, "wheels", "--moving", "map:base", "--x", "1")
    buffer.lookup_transform("map", "base", timeout_s=PATIENCE_S)
    first.signal(SIGKILL)
    eventually(lambda: buffer.frame("base").gone)
    start(bus, "wheels", "--moving", "map:base", "--x", "2")
    eventually(lambda: x_of(buffer, "map", "base") == 2 and not buffer.frame("base").gone)


def test_single_frames_of_a_split_stream_are_read(
    bus: Bus, buffer: Buffer, listener: TransformListener
) -> None:
    """Only frames of the path come in of a stream that sends each frame on its own key."""
    start(bus, "arms", "--split", "--moving", "map:a", "--moving", "a:b/1", "--moving", "map:c")
    buffer.lookup_transform("map", "b/1", timeout_s=PATIENCE_S)
    eventually(lambda: received(listener)["arms"] > 20)
    assert buffer.frames() == ["a", "b/1", "map"]


def test_needed_frames_can_be_named_in_advance(
    bus: Bus, buffer: Buffer, listener: TransformListener
) -> None:
    """After `need` their transforms come without a lookup."""
    start(bus, "wheels", "--moving", "odom:base", "--moving", "odom:other")
    listener.need("odom", "base")
    eventually(lambda: "base" in buffer.frames())
    with pytest.raises(InvalidArgumentException):
        listener.need("", "base")


def test_history_comes_with_a_stream_that_is_read(bus: Bus, receiver: Node, buffer: Buffer) -> None:
    """A stream is asked for its last seconds when it is first read."""
    node = bus.node("sender")
    broadcaster = TransformBroadcaster(node)
    first_ns = time.time_ns() - 2 * 10**9
    for i in range(3):
        transform = TransformStamped(first_ns + i * 10**9, "map", "base", Transform((i, 0, 0)))
        broadcaster.send_transform(transform)
    with TransformListener(buffer, receiver, reads="needed", history_s=10) as listener:
        eventually(lambda: received(listener) == {"sender": 0})
        found = buffer.lookup_transform("map", "base", first_ns + 5 * 10**8, timeout_s=PATIENCE_S)
        assert found.transform.x == pytest.approx(0.5)


def test_edges_that_the_application_put_into_the_buffer_count(
    bus: Bus, buffer: Buffer, listener: TransformListener
) -> None:
    """A path may lead over edges that no stream sends."""
    start(bus, "wheels", "--moving", "map:base", "--x", "2")
    buffer.set_transform(edge("base", "tool", 3), static=True)
    buffer.set_transform(edge("world", "map", 5), static=True)
    found = buffer.lookup_transform("world", "tool", timeout_s=PATIENCE_S)
    assert found.transform.x == pytest.approx(10)


def test_a_corrected_static_comes_in(bus: Bus, buffer: Buffer, listener: TransformListener) -> None:
    """Needed static transforms are kept up to date."""
    broadcaster = StaticTransformBroadcaster(bus.node("model"))
    broadcaster.send_transform(edge("base", "lidar", 1))
    assert buffer.lookup_transform(
        "base", "lidar", timeout_s=PATIENCE_S
    ).transform.x == pytest.approx(1)
    broadcaster.send_transform(edge("base", "lidar", 2))
    eventually(lambda: x_of(buffer, "base", "lidar") == 2)


def test_a_closed_listener_reads_nothing(bus: Bus, receiver: Node, buffer: Buffer) -> None:
    """After `close` no frame becomes needed; the buffer keeps its transforms. Twice is fine."""
    start(bus, "wheels", "--moving", "map:base", "--moving", "map:other")
    listener = TransformListener(buffer, receiver, reads="needed")
    buffer.lookup_transform("map", "base", timeout_s=PATIENCE_S)
    listener.close()
    listener.close()
    assert x_of(buffer, "map", "base") == 0
    with pytest.raises(LookupException, match=r"available: base, map, other") as caught:
        buffer.lookup_transform("map", "nowhere")
    assert caught.value.frame == "nowhere"


def test_reads_is_checked(receiver: Node, buffer: Buffer) -> None:
    """Any word but the two known ones is refused."""
    with pytest.raises(InvalidArgumentException, match="everything, needed"):
        TransformListener(buffer, receiver, reads="some")  # is the test


class Read:
    """The keys that an interest subscribes to, without a bus."""

    def __init__(self) -> None:
        self.open: list[str] = []
        self.forgotten: list[tuple[str, str, set[str]]] = []

    def subscribe(self, stream: str, key: str, static: bool) -> Declaration:
        self.open.append(key)
        return Declaration(_Undeclared(lambda: self.open.remove(key)))

    @property
    def keys(self) -> set[str]:
        """The keys of subscriptions that are open; each of one."""
        assert len(self.open) == len({*self.open})
        return {*self.open}

    def forget(self, stream: str, key: str, frames: set[str]) -> None:
        self.forgotten.append((stream, key, frames))


class _Undeclared:
    def __init__(self, undeclare: Callable[[], None]) -> None:
        self.undeclare = undeclare


def tell(interest: Interest, stream: str, *frames: tuple[str, str, bool]) -> None:
    """Let a stream describe itself."""
    interest.update(live_stream(stream, description(frames)), None)


def test_streams_of_lookups_that_are_not_repeated_are_left() -> None:
    """Their frames are forgotten after `kept_s`; lookups that are repeated, or wait, keep theirs,
    and so does `need`.
    """
    buffer, read = Buffer(), Read()
    clock = [0.0]
    interest = Interest(buffer, read.subscribe, read.forget, kept_s=0.1, clock=lambda: clock[0])
    asked: list[tuple[str, str]] = []
    buffer.watch_questions(lambda target, source: asked.append((target, source)))
    tell(interest, "once", ("map", "a", False), ("map", "a2", False))
    tell(interest, "often", ("map", "b", False))
    tell(interest, "named", ("map", "c", True))
    tell(interest, "waited", ("map", "d", True))
    interest.need("map", "c")
    buffer.can_transform("map", "a")
    with ThreadPoolExecutor() as pool:
        waiting = pool.submit(buffer.lookup_transform, "map", "d", timeout_s=PATIENCE_S)
        eventually(lambda: buffer.waiting)
        for _ in range(5):
            asked.clear()
            clock[0] += 0.05
            eventually(
                lambda: buffer.can_transform("map", "b") or {("map", "b"), ("map", "d")} <= {*asked}
            )
        eventually(lambda: read.forgotten)
        assert read.forgotten == [("once", "tf/once", {"a", "a2"})]
        assert read.keys == {"tf/often", "tf_static/named", "tf_static/waited"}
        buffer.set_transform(edge("map", "d"), static=True)
        assert waiting.result().child_frame_id == "d"
    interest.close()
    assert read.keys == set()


def test_robots_are_asked_for_a_shared_frame_only_if_a_path_needs_it() -> None:
    """Robots whose frames are looked up are wanted at once; robots that list a shared frame if half
    a second later that is still needed, which it is not where it joins both frames. None is wanted
    any longer once it has not been looked up for long.
    """
    buffer, read, clock = Buffer(), Read(), [0.0]
    wanted: list[tuple[set[str], set[str]]] = []
    interest = Interest(buffer, read.subscribe, read.forget, clock=lambda: clock[0])
    interest.need("map", "robot7/arm/base")
    interest.find(Fleet(("map", "hall")), lambda *all: wanted.append((set(all[0]), set(all[1]))))
    robots = {"", "robot7", "robot7/arm"}
    eventually(lambda: wanted == [(robots, set())])
    tell(interest, "robot7/wheels", ("map", "robot7/arm/base", False))
    eventually(lambda: read.keys)
    clock[0] = 1.0
    interest.need("hall", "robot7/arm/base")
    interest.need("map", "robot8/base")
    eventually(lambda: wanted[1:] == [({*robots, "robot8"}, set())])
    clock[0] = 1.6
    buffer.can_transform("map", "robot9/base")
    shared = {"map", "hall"}
    eventually(lambda: wanted[2:] == [({*robots, "robot8", "robot9"}, shared)])

    def is_left() -> bool:
        clock[0] += 10.0
        interest.need("map", "robot8/base")
        return wanted[3:] == [({*robots, "robot8"}, shared)]

    eventually(is_left)
    assert clock[0] > 1.6 + KEPT_S
    interest.close()


def test_robots_are_not_asked_before_the_needed_one_has_said_its_frames() -> None:
    """Many robots are slow to say theirs: none of the others is asked about a shared frame for 5 s,
    or before the frames of the one are known.
    """
    buffer, read, clock = Buffer(), Read(), [0.0]
    frames: list[set[str]] = []
    interest = Interest(buffer, read.subscribe, read.forget, clock=lambda: clock[0])
    interest.find(Fleet(("map", "hall")), lambda _, shared: frames.append({*shared}))

    def wants(number: int) -> bool:
        """Whether it wants one more, as it does each time that it looks at all that is needed."""
        buffer.can_transform("odom", f"robot{number}/base")
        return len(frames) == number

    interest.need("map", "robot1/base")
    eventually(lambda: wants(1))
    clock[0] = 4.9
    eventually(lambda: wants(2))
    assert frames == [set(), set()]
    tell(interest, "robot1/wheels", ("hall", "robot1/base", False))
    eventually(lambda: frames[2:] == [{"map"}])
    interest.close()
    late = Interest(buffer, read.subscribe, read.forget, clock=lambda: clock[0])
    late.need("map", "robot3/base")
    late.find(Fleet(("map", "hall")), lambda _, shared: frames.append({*shared}))
    eventually(lambda: len(frames) == 4)
    clock[0] += 5.0
    buffer.can_transform("map", "robot4/base")
    eventually(lambda: frames[-1] == {"map"})
    late.close()


@pytest.mark.parametrize("error", [ValueError("subscribe"), BusError("the link is down")])
def test_an_error_does_not_end_an_interest(
    error: Exception, caplog: pytest.LogCaptureFixture
) -> None:
    """A failing subscription is logged once and retried, and keeps no other from being read."""
    buffer, read = Buffer(), Read()
    failures: list[str] = []

    def subscribe(stream: str, key: str, static: bool) -> Declaration:
        if stream == "wheels" and len(failures) < 2:
            failures.append(key)
            eventually(lambda: len(failures) < 2 or read.keys)
            raise error
        return read.subscribe(stream, key, static)

    interest = Interest(buffer, subscribe, read.forget, kept_s=0.1)
    tell(interest, "wheels", ("map", "base", False))
    tell(interest, "arm", ("base", "tool", False))
    interest.need("map", "tool")
    interest.need("map", "base")
    eventually(lambda: read.keys == {"tf/wheels", "tf/arm"})
    interest.close()
    assert failures == ["tf/wheels"] * 2
    (record,) = caplog.records
    assert record.getMessage().startswith("Could not subscribe")


def test_an_error_in_leaving_a_stream_does_not_end_an_interest(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """It is logged once, and what is needed later is read."""
    buffer, read, clock = Buffer(), Read(), [0.0]
    errors: list[str] = []

    def forget(stream: str, key: str, frames: set[str]) -> None:
        errors.append(stream)
        raise ValueError("forget")

    interest = Interest(buffer, read.subscribe, forget, kept_s=0.1, clock=lambda: clock[0])
    tell(interest, "wheels", ("map", "base", False))
    buffer.can_transform("map", "base")
    eventually(lambda: read.keys)

    def is_left() -> bool:
        clock[0] += 0.05
        return errors == ["wheels"]

    eventually(is_left)
    tell(interest, "arm", ("base", "tool", False))
    interest.need("base", "tool")
    eventually(lambda: read.keys == {"tf/arm"})
    interest.close()
    (record,) = caplog.records
    assert record.getMessage().startswith("Could not follow")


def test_a_message_that_comes_after_its_key_is_left_is_dropped(
    bus: Bus, receiver: Node, buffer: Buffer, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A late message does not bring a forgotten frame back."""
    late: list[Callable[[], None]] = []
    subscriber = receiver.session.subscriber

    def subscribe(key: str, callback: Callable[[str, bytes], None]) -> Declaration:
        def on_message(at: str, payload: bytes) -> None:
            late.append(lambda: callback(at, payload))
            callback(at, payload)

        return subscriber(key, on_message)

    monkeypatch.setattr(receiver.session, "subscriber", subscribe)
    monkeypatch.setitem(Interest.__init__.__kwdefaults__, "kept_s", 0.5)
    start(bus, "wheels", "--moving", "map:base")
    with TransformListener(buffer, receiver, reads="needed"):
        buffer.lookup_transform("map", "base", timeout_s=PATIENCE_S)
        eventually(lambda: "base" not in buffer.frames())
        late[-1]()
        assert "base" not in buffer.frames()


def test_the_buffer_is_not_asked_for_an_error_about_each_unknown_frame() -> None:
    """Such an error copies the names of all frames, and frames that nothing has sent are many."""

    class Asked(Buffer):
        def frame(self, name: str) -> FrameInfo:
            raise AssertionError("frame() is for people")

    buffer, read = Asked(), Read()
    interest = Interest(buffer, read.subscribe, read.forget)
    tell(interest, "wheels", ("map", "base", False))
    interest.need("base", "map")
    eventually(lambda: read.keys == {"tf/wheels"})
    with pytest.raises(LookupException, match="reading stream 'wheels'"):
        buffer.lookup_transform("map", "base")
    interest.close()
    assert buffer.known_frame("base") is None
    buffer.set_transform(edge("map", "base"))
    assert (info := buffer.known_frame("base")) is not None and info.parent == "map"


def test_streams_beside_the_paths_cost_no_search(monkeypatch: pytest.MonkeyPatch) -> None:
    """An interest is followed again if a stream changes an edge on the way up, not
    for two hundred other streams, nor for one that says the same again.
    """
    searches: list[object] = []
    edges_needed = DescribedTree.edges_needed

    def search(tree: DescribedTree, pairs: Iterable[tuple[str, str]]) -> list[DescribedEdge]:
        searches.append(pairs)
        return edges_needed(tree, pairs)

    monkeypatch.setattr(DescribedTree, "edges_needed", search)
    buffer, read = Buffer(), Read()
    interest = Interest(buffer, read.subscribe, read.forget, clock=lambda: 0.0)
    interest.need("map", "tool")
    tell(interest, "arm", ("base", "tool", True))
    eventually(lambda: read.keys == {"tf_static/arm"})
    before = len(searches)
    for number in range(200):
        tell(interest, f"robot{number}", ("map", f"base{number}", False))
        tell(interest, "arm", ("base", "tool", True))
    tell(interest, "wheels", ("map", "base", False))
    eventually(lambda: read.keys == {"tf_static/arm", "tf/wheels"})
    interest.close()
    # One for the last stream; a wake of before, and that of the end, may be under way.
    assert len(searches) - before <= 3
