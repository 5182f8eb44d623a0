"""Count what a robot sends over its link: `python -m benchmarks.bus.air` prints the table.

The robot is a client of a router behind a relay that counts the bytes of TCP both ways, with a
listener on the far side. Bytes do not depend on how busy the machine is.
"""

import logging
import socket
import threading
import time
from typing import Any

import tfbus
from benchmarks.bus.place import free_port
from tfbus.bus.session import Session
from tfbus.bus.settings import NodeSettings

# What Ethernet, IP and TCP add to each packet.
HEADERS = 66
SETTLE_S, COUNT_S = 3.0, 6.0

# Transforms in a message, messages a second.
ROBOTS = [(0, 0), (2, 20), (10, 20), (50, 20), (50, 50)]


class Relay:
    """Passes one connection on to a port, and counts its bytes and packets, out and back."""

    def __init__(self, port: int) -> None:
        self.bytes, self.packets = [0, 0], [0, 0]
        self._front = socket.create_server(("127.0.0.1", 0))
        self.port = self._front.getsockname()[1]
        threading.Thread(target=self._accept, args=(port,), daemon=True).start()

    def _accept(self, port: int) -> None:
        while True:
            near, _ = self._front.accept()
            far = socket.create_connection(("127.0.0.1", port))
            for way, (source, sink) in enumerate(((near, far), (far, near))):
                source.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                threading.Thread(target=self._pass, args=(source, sink, way), daemon=True).start()

    def _pass(self, source: socket.socket, sink: socket.socket, way: int) -> None:
        while data := source.recv(65_536):
            sink.sendall(data)
            self.bytes[way] += len(data)
            self.packets[way] += 1


def measure(frames: int, rate_hz: int) -> tuple[float, float]:
    """Bytes a second that a robot sends, and receives, with the headers of packets."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    log = logging.getLogger("air")
    out = back = 0.0
    with Session(NodeSettings("router", mode="router", listen=(endpoint,)), log):
        relay = Relay(int(endpoint.rpartition(":")[2]))
        robot: dict[str, Any] = {"mode": "client", "connect": (f"tcp/127.0.0.1:{relay.port}",)}
        there: dict[str, Any] = {"mode": "client", "connect": (endpoint,)}
        with (
            tfbus.Node(settings=NodeSettings("robot", namespace="robot7", **robot)) as node,
            tfbus.Node(settings=NodeSettings("far", namespace="robot7", **there)) as far,
            tfbus.TransformListener(tfbus.Buffer(), far),
        ):
            if frames:
                _send(node, frames, rate_hz)
            time.sleep(SETTLE_S)
            before = relay.bytes[:], relay.packets[:]
            time.sleep(COUNT_S)
            out, back = (
                (
                    relay.bytes[way]
                    - before[0][way]
                    + HEADERS * (relay.packets[way] - before[1][way])
                )
                / COUNT_S
                for way in (0, 1)
            )
    return out, back


def _send(node: tfbus.Node, frames: int, rate_hz: int) -> None:
    broadcaster = tfbus.TransformBroadcaster(node)
    pose = tfbus.Transform((1.0, 2.0, 3.0), (0.0, 0.0, 0.6, 0.8))

    def send() -> None:
        now_ns = node.now_ns()
        broadcaster.send_transform(
            [tfbus.TransformStamped(now_ns, "base", f"link_{n}", pose) for n in range(frames)]
        )

    node.create_timer(1.0 / rate_hz, send)


def main() -> None:
    """Print a table, of which docs/guide/scaling.md has the sent bytes."""
    print("| transforms in a message | messages a second | sent | received |")
    print("| ---: | ---: | ---: | ---: |")
    for frames, rate_hz in ROBOTS:
        out, back = measure(frames, rate_hz)
        print(
            f"| {frames} | {rate_hz} | {out / 1e3:.1f} kB/s | {back / 1e3:.1f} kB/s |", flush=True
        )


if __name__ == "__main__":
    main()
