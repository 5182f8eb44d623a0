"""A leg alone: sends a dynamic and a static frame, and prints received messages and nodes, in JSON.

python leg_node.py VIA DYNAMIC STATIC [CONNECT ...]
"""

import json
import logging
import signal
import sys
import threading
import time
from typing import Any

from tfbus import Transform, TransformStamped
from tfbus.geometry.columns import Columns
from tfbus.ros.bridge.legs import LegSettings, OnMessage, RosTopic, open_leg
from tfbus.ros.definitions import TF_MESSAGE
from tfbus.ros.tf_message import TFMessageReader, TFMessageWriter

TF = RosTopic("/tf", TF_MESSAGE)
TF_STATIC = RosTopic("/tf_static", TF_MESSAGE, retained=True, depth=1)
PERIOD_S = 0.1


def message(child: str) -> bytes:
    """One transform, of now."""
    transform = TransformStamped(time.time_ns(), "map", child, Transform([1.5, 0.0, 0.0]))
    return TFMessageWriter().write(Columns.of_transforms([transform]))


def hears(topic: RosTopic) -> OnMessage:
    """Says what comes on a topic."""
    reader = TFMessageReader()

    def hear(payload: bytes, gid: str) -> None:
        rows = reader.read(payload)
        say(heard=topic.name, children=sorted(rows.children()), gid=gid)

    return hear


def say(**values: Any) -> None:
    """Print one line, whole also where threads do so at once."""
    sys.stdout.write(f"{json.dumps(values)}\n")
    sys.stdout.flush()


def main(via: str, dynamic: str, static: str, *connect: str) -> None:
    """Run until a signal."""
    logging.basicConfig(level=logging.WARNING)
    ended = threading.Event()
    signal.signal(signal.SIGINT, lambda *_: ended.set())
    leg = open_leg(via, LegSettings(connect=connect), logging.getLogger("leg"))
    say(leg=leg.name, tells_publishers=leg.tells_publishers)
    for topic in (TF, TF_STATIC):
        leg.subscribe(topic, hears(topic))
    statics, sender = leg.publisher(TF_STATIC), leg.publisher(TF)
    say(gids={TF.name: sender.gid, TF_STATIC.name: statics.gid})
    statics.send(message(static))
    seen: dict[str, Any] = {}
    while not ended.wait(PERIOD_S):
        sender.send(message(dynamic))
        now = {
            "publishers": {
                topic.name: sorted([each.gid, each.node] for each in leg.publishers(topic.name))
                for topic in (TF, TF_STATIC)
            },
            "warnings": list(leg.warnings()),
            "heard_by_ros": sender.heard,
        }
        if now != seen:
            seen = now
            say(**seen)
    leg.close()
    say(closed=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
