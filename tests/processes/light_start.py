"""A node that sends, listens and looks up single transforms: prints which of the modules that it
does not need, most of which take long to import, it has imported.

python light_start.py
"""

import json
import sys

from tfbus import (
    Buffer,
    Node,
    StaticTransformBroadcaster,
    Transform,
    TransformBroadcaster,
    TransformListener,
    TransformStamped,
)

WITHIN_S = 20.0
HEAVY = (
    "numpy",
    "asyncio",
    "yaml",
    "importlib.metadata",
    "click",
    "email",
    "tempfile",
    "unicodedata",
    "tfbus.bus.first_link",
)


def main() -> None:
    """Look up a dynamic and a static frame of another process, and one of its own."""
    with Node("light") as node:
        buffer = Buffer()
        TransformListener(buffer, node)
        broadcaster = TransformBroadcaster(node)
        laser = Transform((1, 2, 3.5), [0, 0, 0, 1])
        StaticTransformBroadcaster(node).send_transform(TransformStamped(0, "base", "laser", laser))
        now_ns = node.now_ns()
        broadcaster.send_transform(TransformStamped(now_ns, "map", "base", Transform.identity()))
        several = [TransformStamped(now_ns, "map", name, laser) for name in ("left", "right")]
        broadcaster.send_transform(several)
        for frame in ("laser", "robot", "camera", "left"):
            buffer.lookup_transform("map", frame, timeout_s=WITHIN_S)
    print(json.dumps([name for name in HEAVY if name in sys.modules]), flush=True)


if __name__ == "__main__":
    main()
