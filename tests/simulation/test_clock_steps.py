"""Clocks of hosts that are set while processes run."""

import tfbus
from tfbus.testing import Network


def test_a_listener_whose_clock_is_set_back_brings_no_dead_publisher_back(
    network: Network,
) -> None:
    """The last message of a publisher that died lies in the future of the clock then."""
    network.host("h1"), network.host("h2")
    with network.process("h1", "sim"):
        node = tfbus.Node("sim")
        broadcaster = tfbus.TransformBroadcaster(node)

    def send() -> None:
        pose = tfbus.Transform((1.0, 0.0, 0.0))
        broadcaster.send_transform(tfbus.TransformStamped(node.now_ns(), "world", "robot", pose))

    node.create_timer(0.1, send)
    with network.process("h2", "listener"):
        listener = tfbus.TransformListener(tfbus.Buffer(), tfbus.Node("listener"))
    changes: list[str] = []
    network.run(until=lambda: "robot" in listener.buffer.frames())
    listener.buffer.on_change(lambda change: changes.append(change.kind))
    network.power_off("h1")
    network.host("h2").step_clock(-8.0)
    network.run(30.0)
    assert changes == ["publisher gone"]
