"""Calls as in ROS: the error says how it is done here."""

import logging
import re
from collections.abc import Callable
from io import StringIO
from typing import Any

import pytest

import tfbus
from tests.simulated_bus import Bus
from tfbus import Buffer, Node, Transform, TransformBroadcaster, TransformListener, TransformStamped
from tfbus.base.ros_names import _OURS, add_note
from tfbus.compat import tf2_ros

CALLS: dict[str, tuple[Callable[[Node], Any], str]] = {
    "sendTransform": (
        lambda node: TransformBroadcaster(node).sendTransform,
        "send_transform",
    ),
    "lookupTransform": (
        lambda node: Buffer().lookupTransform,
        "buffer.lookup_transform",
    ),
    "lookupTransform of a listener": (
        lambda node: TransformListener(Buffer(), node).lookupTransform,
        "buffer.lookup_transform",
    ),
    "timeout": (
        lambda node: Buffer().lookup_transform("a", "b", 0, timeout=1.0),
        "buffer.lookup_transform.*timeout_s=",
    ),
    "a fourth argument": (
        lambda node: Buffer().can_transform("a", "b", 0, 1.0),
        "buffer.can_transform.*timeout_s=",
    ),
    "header": (
        lambda node: TransformStamped(0, "a", "b", Transform()).header,
        "stamp_ns",
    ),
}


@pytest.mark.parametrize("call", CALLS)
def test_the_error_that_leaves_a_node_has_our_call(bus: Bus, call: str) -> None:
    """A call as in ROS, in a node's `with`: the error has one note, with the call of tfbus."""
    attempt, ours = CALLS[call]
    with pytest.raises((AttributeError, TypeError)) as caught, bus.node("a") as a, bus.node("b"):
        attempt(a)
    (note,) = caught.value.__notes__
    assert re.match(f"use: .*{ours}.* tfbus.compat", note)


def test_the_log_of_a_callback_has_our_call(bus: Bus) -> None:
    """A callback that calls as in ROS fails in the log, with the call of tfbus below."""
    written = StringIO()
    node = bus.node("a")
    node.log.addHandler(logging.StreamHandler(written))
    node.create_timer(0.1, lambda: TransformBroadcaster(node).sendTransform)
    bus.network.run(until=lambda: "\nuse: send_transform(" in written.getvalue())


@pytest.mark.parametrize(
    "attempt",
    [
        lambda: Buffer().lookupTransfrom,
        lambda: Buffer().lookup_transform("a"),
        lambda: tf2_ros.Buffer().lookupTransform,
        lambda: object().sendTransform,
        lambda: TransformBroadcaster(),
    ],
)
def test_other_errors_stay_as_they_are(attempt: Callable[[], Any]) -> None:
    """A slip, a program of tfbus.compat and an object of others get no note."""
    with pytest.raises((AttributeError, TypeError)) as caught:
        attempt()
    add_note(caught.value)
    assert not hasattr(caught.value, "__notes__")


def test_our_calls_are_there(bus: Bus) -> None:
    """Each call that a hint names exists."""
    places = {"tfbus": tfbus, "node": bus.node("a"), "buffer": Buffer()}
    hints = " ".join(ours for names in _OURS.values() for ours in names.values())
    for place, name in re.findall(r"(?<!\.)\b(tfbus|node|buffer)\.(\w+)", hints):
        assert hasattr(places[place], name), f"{place}.{name}"
