"""Listeners that ask for transforms from before they came."""

import signal
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

from tests.buses import DEADLINE_S, eventually
from tests.live_bus import free_port
from tests.processes.publishers import start
from tests.simulated_bus import Bus
from tfbus import (
    Buffer,
    ExtrapolationException,
    InvalidArgumentException,
    PastExtrapolationException,
    SingleSampleException,
    Transform,
    TransformBroadcaster,
    TransformListener,
    TransformStamped,
)
from tfbus.streams.history import AskedHistory

S = 10**9


def oldest_ns(buffer: Buffer, child: str) -> int:
    """The stamp of the oldest sample, now where there is none."""
    known = child in buffer.frames()
    oldest = buffer.frame(child).oldest_ns if known else None
    return time.time_ns() if oldest is None else oldest


def run_for(buffer: Buffer, seconds: float) -> None:
    """Wait until a buffer has received from a publisher for this long."""
    first_ns = oldest_ns(buffer, "robot")
    eventually(
        lambda: (
            buffer.can_transform("world", "robot")
            and buffer.lookup_transform("world", "robot").stamp_ns - first_ns > seconds * S
        )
    )


def test_the_last_seconds_come_to_who_asks(bus: Bus) -> None:
    """A listener has as many of the seconds before it came as it asked for, others have none."""
    witness = Buffer()
    TransformListener(witness, bus.node("witness"))
    start(bus, "sim", "--moving", "robot")
    run_for(witness, 3.0)
    asking, silent = Buffer(), Buffer()
    came_ns = time.time_ns()
    with (
        TransformListener(asking, bus.node("asking"), history_s=1.0) as listener,
        TransformListener(silent, bus.node("silent")),
    ):
        eventually(lambda: oldest_ns(asking, "robot") < came_ns)
        eventually(lambda: silent.can_transform("world", "robot"))
        assert oldest_ns(asking, "robot") > came_ns - 2 * S
        assert oldest_ns(silent, "robot") > came_ns - S // 2
        assert asking.frame("robot").conflicts == 0
        assert [info.missed for info in listener.streams()] == [0]


def test_what_a_publisher_sent_before_it_was_met_comes_too(bus: Bus) -> None:
    """A listener that was there first has the first messages of those who come later."""
    buffer = Buffer()
    with TransformListener(buffer, bus.node("first"), history_s=10.0):
        for _ in range(2):
            process = start(bus, "sim", "--moving", "robot", "--from", "1000")
            # The first message was sent before there was a subscriber.
            eventually(
                lambda: (
                    "robot" in buffer.frames()
                    and buffer.can_transform("world", "robot", living=True)
                    and oldest_ns(buffer, "robot") == 1000 * S
                )
            )
            process.stop(signal.SIGKILL)


@pytest.mark.real
@pytest.mark.parametrize("comes_first", ["listener", "publisher"])
def test_history_comes_through_a_router(bus: Bus, comes_first: str) -> None:
    """Clients of a router have what was sent before they met, whichever came first."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    bus.start("router", "--listen", endpoint).wait_for_line("Routing on")
    env = {"TFBUS_MODE": "client", "TFBUS_CONNECT": endpoint}
    # As long as the test: on a busy machine the listener may come long after the first message.
    arguments = ("sim", "--moving", "robot", "--from", "1000", "--history", str(DEADLINE_S))
    if comes_first == "publisher":
        start(bus, *arguments, env=env)
    node = bus.node("listener", mode="client", connect=(endpoint,))
    buffer = Buffer(cache_time_s=DEADLINE_S)
    with TransformListener(buffer, node, history_s=DEADLINE_S):
        if comes_first == "listener":
            start(bus, *arguments, env=env)
        eventually(lambda: oldest_ns(buffer, "robot") == 1000 * S)


def test_unanswered_queries_for_history_are_repeated(
    bus: Bus, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where the first questions find no way to the publisher, the next one does."""
    # Before the listener's node is there: it cannot come but as history.
    TransformBroadcaster(bus.node("sim")).send_transform(
        TransformStamped(S, "world", "robot", Transform())
    )
    node = bus.node("listener")
    ask_later = node.session.ask_later
    unheard: list[str] = []

    def ask(key: str, payload: Any, on_answer: Any, on_end: Any, **how: Any) -> None:
        if "last_s" in key and len(unheard) < 2:
            unheard.append(key)
            on_end()
        else:
            ask_later(key, payload, on_answer, on_end, **how)

    monkeypatch.setattr(node.session, "ask_later", ask)
    buffer = Buffer()
    with TransformListener(buffer, node, history_s=60.0):
        eventually(lambda: oldest_ns(buffer, "robot") == S)
    assert [key.partition(";")[0] for key in unheard] == ["tf/sim/**?last_s=60"] * 2


def test_the_history_of_split_streams_comes_from_all_keys(bus: Bus) -> None:
    """Of a stream with a key for each frame the past of all frames comes."""
    broadcaster = TransformBroadcaster(bus.node("sim"), split=True)
    children = ["a", "b c", "d/e"]
    for i in range(1, 6):
        broadcaster.send_transform(
            TransformStamped(i * S, "world", child, Transform((i, 0, 0))) for child in children
        )
    buffer = Buffer()
    with TransformListener(buffer, bus.node("late"), history_s=10.0):
        eventually(lambda: set(children) < set(buffer.frames()))
        for child in children:
            eventually(lambda child=child: buffer.frame(child).samples == 5)


@pytest.mark.parametrize("impossible", [-1.0, float("inf"), float("nan")])
def test_history_is_a_number_of_seconds(bus: Bus, impossible: float) -> None:
    """Less than nothing, and for ever, are refused."""
    with pytest.raises(InvalidArgumentException, match="history_s must be"):
        TransformListener(Buffer(), bus.node("listener"), history_s=impossible)


def test_a_lookup_of_the_past_waits_for_history(bus: Bus) -> None:
    """A lookup of the past, made when the first message has come, succeeds within its timeout."""
    witness = Buffer()
    TransformListener(witness, bus.node("witness"))
    start(bus, "sim", "--moving", "robot")
    run_for(witness, 2.0)
    node = bus.node("joining")
    for _ in range(10):
        buffer = Buffer()
        with TransformListener(buffer, node, history_s=5.0):
            buffer.lookup_transform("world", "robot", timeout_s=30.0)
            past_ns = time.time_ns() - S
            past = buffer.lookup_transform("world", "robot", past_ns, timeout_s=30.0)
            assert past.stamp_ns == past_ns


def test_a_message_may_come_long_before_the_history_is_asked_for(
    bus: Bus, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From the first message on a lookup of the past waits, though nothing was asked for yet."""
    started = threading.Event()
    ask = AskedHistory.ask

    def ask_late(self: AskedHistory, key: str, stream: Any) -> None:
        started.wait(10.0)
        ask(self, key, stream)

    monkeypatch.setattr(AskedHistory, "ask", ask_late)
    broadcaster = TransformBroadcaster(bus.node("sim"))
    broadcaster.send_transform(TransformStamped(S, "world", "robot", Transform()))
    buffer = Buffer()
    with TransformListener(buffer, bus.node("listener"), history_s=60.0):

        def has_come() -> bool:
            broadcaster.send_transform(TransformStamped(3 * S, "world", "robot", Transform()))
            return buffer.can_transform("world", "robot")

        eventually(has_come)
        with ThreadPoolExecutor() as pool:
            past = pool.submit(buffer.lookup_transform, "world", "robot", 2 * S, timeout_s=30.0)
            eventually(lambda: buffer.waiting == 1)
            started.set()
            assert past.result().stamp_ns == 2 * S


def test_lookups_do_not_wait_for_a_past_that_no_stream_keeps(bus: Bus) -> None:
    """A time before all history fails as soon as that has come, with the true reason."""
    start(bus, "sim", "--moving", "robot", "--from", "1000")
    buffer = Buffer()
    with TransformListener(buffer, bus.node("asking"), history_s=60.0):
        buffer.lookup_transform("world", "robot", timeout_s=30.0)
        with pytest.raises(ExtrapolationException):
            buffer.lookup_transform("world", "robot", 900 * S, timeout_s=60.0)
        assert oldest_ns(buffer, "robot") == 1000 * S


@pytest.mark.parametrize("samples", [1, 2])
def test_the_past_is_waited_for_where_it_is_expected(samples: int) -> None:
    """A lookup of a time before the first sample waits until the past has come, and no longer."""
    buffer = Buffer()
    for i in range(samples):
        stamped = TransformStamped((3 + i) * S, "world", "robot", Transform())
        buffer.set_transform(stamped, authority="sim")
    end = buffer.expect_past("sim")
    with ThreadPoolExecutor() as pool:
        known = pool.submit(buffer.lookup_transform, "world", "robot", 2 * S, timeout_s=30.0)
        never = pool.submit(buffer.lookup_transform, "world", "robot", 0, timeout_s=30.0)
        eventually(lambda: buffer.waiting == 2)
        buffer.set_transform(TransformStamped(S, "world", "robot", Transform()), authority="sim")
        end()
        assert known.result().stamp_ns == 2 * S
        with pytest.raises(PastExtrapolationException):
            never.result()


def test_the_past_of_one_stream_is_not_expected_of_another() -> None:
    """Where another stream's past is expected, a lookup of the past fails at once."""
    buffer = Buffer()
    buffer.set_transform(TransformStamped(3 * S, "world", "robot", Transform()), authority="sim")
    end = buffer.expect_past("other")
    with pytest.raises(SingleSampleException):
        buffer.lookup_transform("world", "robot", 2 * S, timeout_s=30.0)
    end()
    with pytest.raises(SingleSampleException):
        buffer.lookup_transform("world", "robot", 2 * S, timeout_s=30.0)
