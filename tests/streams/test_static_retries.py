"""Static transforms that the buffer refused: when they are retried, and when no longer."""

from tests.builders import at
from tests.buses import eventually
from tests.simulated_bus import Bus
from tests.streams.received import Received
from tfbus import Buffer, StaticTransformBroadcaster, TransformListener


def test_a_part_of_the_set_that_is_taken_leaves_the_rest_refused() -> None:
    """A child that the stream lists late is put in; another is still retried."""
    received = Received()
    received.buffer.set_transform(at(1, "world", parent="base"), static=True, authority="wrong")
    received.send_static(at(2, "base"), at(3, "post"))
    received.buffer.remove_sent(["post"], "sim")
    received.stream.describe(1, frozenset({"base", "post"}), frozenset({"post"}))
    assert (received.x_of("post"), received.buffer.frame("world").authority) == (3.0, "wrong")
    received.buffer.remove_sent(["world"], "wrong")
    assert received.x_of("base") == 2.0


def test_a_part_of_the_set_that_is_refused_leaves_the_rest_refused() -> None:
    """Each refused child has frames in its way; those of one do not replace those of another."""
    received = Received()
    buffer = received.buffer
    buffer.set_transform(at(1, "world", parent="base"), static=True, authority="wrong")
    buffer.set_transform(at(1, "map", parent="cart"), static=True, authority="other")
    received.send_static(at(2, "base"), at(3, "cart", parent="map"))
    received.stream.describe(1, frozenset({"base", "cart"}), frozenset({"cart"}))
    buffer.remove_sent(["world"], "wrong")
    assert received.x_of("base") == 2.0
    buffer.remove_sent(["map"], "other")
    assert buffer.frame("cart").parent == "map"


def test_a_closed_listener_retries_nothing(bus: Bus) -> None:
    """What is in the way may end later: the buffer belongs to the caller again."""
    buffer = Buffer()
    buffer.set_transform(at(1, "world", parent="base"), static=True, authority="wrong")
    with TransformListener(buffer, bus.node("listener")):
        StaticTransformBroadcaster(bus.node("sim")).send_transform([at(2, "base"), at(3, "post")])
        eventually(lambda: "post" in buffer.frames() and buffer.rejected.rows > 0)
    buffer.remove_sent(["world"], "wrong")
    assert buffer.frame("base").parent is None
