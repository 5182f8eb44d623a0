"""Peers of the last release, and of other releases of Zenoh, are understood, and understand."""

import os
import sys
from pathlib import Path

import pytest

from tests.buses import DEADLINE_S, eventually, keep_sending, send_static
from tests.live_bus import Bus, free_port
from tfbus import Buffer, TransformListener
from tfbus.messages import Spawn

pytestmark = pytest.mark.real

HERE = Path(__file__).parents[1]
RELEASES = sorted((HERE / "wire" / "frozen").glob("*.json"))
# Pythons with an eclipse-zenoh of their own, as `make release-check` sets them up.
PYTHONS = [sys.executable, *filter(None, os.environ.get("TFBUS_OTHER_ZENOH", "").split(":"))]


every_python = pytest.mark.parametrize(
    "python", PYTHONS, ids=lambda path: Path(path).parents[1].name
)


@pytest.mark.parametrize("release", RELEASES, ids=lambda path: path.stem)
@every_python
def test_a_peer_of_another_release_is_understood(bus: Bus, release: Path, python: str) -> None:
    """Its dynamic and static transforms, its token, description and service arrive here; ours
    arrive there, also the static ones that were sent before it came.
    """
    node = bus.node("ours")
    send_static(node, "world", "house")
    keep_sending(node, "world", "robot")
    buffer = Buffer()
    listener = TransformListener(buffer, node)
    program = str(HERE / "processes" / "plain_peer.py")
    peer = bus.start_command(
        [python, "-I", program, str(release), str(bus.quick_config), bus.endpoint]
    )
    peer.wait_for_line("ready eclipse-zenoh")
    for child in ("turtle1", "drone", "dock"):
        eventually(lambda child=child: buffer.can_transform("world", child))
    assert buffer.lookup_transform("world", "turtle1").transform.quat_xyzw[2:].tolist() == [
        0.6,
        0.8,
    ]
    peer.wait_for_line(r"received tf_static/ours \['world', 'house'\]")
    peer.wait_for_line(r"received tf/ours \['world', 'robot'\]")
    peer.wait_for_line("token @tfbus/stream/ours SampleKind.PUT")
    eventually(lambda: "sim" in {stream.name for stream in listener.streams() if stream.alive})
    spawn = node.create_client(Spawn, "spawn")
    assert spawn.call(Spawn.Request(1.0, 2.0), timeout_s=DEADLINE_S).name == "a text"
    peer.kill()
    eventually(lambda: not any(s.alive for s in listener.streams() if s.name == "sim"))


@every_python
def test_a_router_of_another_release_passes_everything_on(bus: Bus, python: str) -> None:
    """Dynamic transforms, and static ones that were sent before the listener came."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    program = str(HERE / "processes" / "plain_router.py")
    router = bus.start_command([python, "-I", program, endpoint])
    router.wait_for_line("ready eclipse-zenoh")
    sender = bus.node("sender", mode="client", connect=(endpoint,), config="")
    send_static(sender, "world", "house")
    keep_sending(sender, "world", "robot")
    receiver = bus.node("receiver", mode="client", connect=(endpoint,), config="")
    buffer = Buffer()
    listener = TransformListener(buffer, receiver)
    for child in ("house", "robot"):
        eventually(lambda child=child: buffer.can_transform("world", child))
    eventually(lambda: [stream.name for stream in listener.streams() if stream.alive])
    sender.close()
    eventually(lambda: not [stream.name for stream in listener.streams() if stream.alive])
