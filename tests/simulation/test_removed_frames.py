"""Frames that are removed while a listener gets to know their stream."""

import tfbus
from tfbus.testing import Network


def _send(broadcaster: tfbus.TransformBroadcaster, node: tfbus.Node, *frames: str) -> None:
    here = tfbus.Transform((1.0, 0.0, 0.0))
    broadcaster.send_transform(
        [tfbus.TransformStamped(node.now_ns(), "world", frame, here) for frame in frames]
    )


def test_a_frame_that_was_removed_before_the_first_list_goes(network: Network) -> None:
    """A message of it came, the first description is without it: it goes within a few seconds."""
    network.path(network.host("h1"), network.host("h2"), delay_s=0.5)
    with network.process("h1", "sim"):
        node = tfbus.Node("sim")
        broadcaster = tfbus.TransformBroadcaster(node)
        _send(broadcaster, node, "kept", "removed")
    network.run(5.0)
    with network.process("h2", "listener"):
        listener = tfbus.TransformListener(tfbus.Buffer(), tfbus.Node("listener"))
    network.run(until=lambda: broadcaster._sender.heard)
    _send(broadcaster, node, "kept", "removed")
    broadcaster.remove("removed")
    buffer = listener.buffer
    network.run(until=lambda: "removed" in buffer.frames())
    network.run(5.0)
    assert buffer.frames() == ["kept", "world"]


def test_a_frame_whose_description_is_late_stays(network: Network) -> None:
    """One that was sent once, and is listed when the description comes, is not dropped."""
    network.path(network.host("h1"), network.host("h2"), delay_s=3.0)
    with network.process("h1", "sim"):
        node = tfbus.Node("sim")
        broadcaster = tfbus.TransformBroadcaster(node)
        _send(broadcaster, node, "first")
    with network.process("h2", "listener"):
        listener = tfbus.TransformListener(tfbus.Buffer(), tfbus.Node("listener"))
    network.run(30.0)
    _send(broadcaster, node, "second")
    network.run(30.0)
    assert listener.buffer.frames() == ["second", "world"]
