"""A node that hears frames, forks, and hears on: prints its children's results, and the end.

python forking_node.py USE...
"""

import multiprocessing
import os
import signal
import sys
import time

from tfbus import (
    Buffer,
    BusError,
    Node,
    Transform,
    TransformBroadcaster,
    TransformListener,
    TransformStamped,
)

WITHIN_S = 20.0


def use(node: Node, broadcaster: TransformBroadcaster, what: str) -> None:
    """What the child does with its parent's node, or beside it."""
    if what == "another node":
        Node("another")
    elif what == "send":
        stamp_ns = time.time_ns()
        broadcaster.send_transform(TransformStamped(stamp_ns, "map", "a", Transform.identity()))
    elif what == "spin":
        node.spin()
    elif what == "timer":
        node.create_timer(1.0, print)
    elif what == "listen":
        TransformListener(Buffer(), node)
    elif what == "close":
        node.close()
    elif what == "leave":
        node.shutdown()
        sys.exit(0)
    elif what == "signal":
        os.kill(os.getpid(), signal.SIGTERM)


def child(node: Node, broadcaster: TransformBroadcaster, what: str) -> None:
    """Use it, and print what comes of that."""
    try:
        use(node, broadcaster, what)
        print("child: no error", flush=True)
    except BusError as error:
        print(f"child: {error}", flush=True)


def main(uses: list[str]) -> None:
    """Hear, fork, wait for the child, hear on."""
    with Node("parent") as node:
        broadcaster = TransformBroadcaster(node)
        broadcaster.send_transform(
            TransformStamped(time.time_ns(), "map", "a", Transform.identity())
        )
        buffer = Buffer()
        TransformListener(buffer, node)
        buffer.lookup_transform("map", "robot", timeout_s=WITHIN_S)
        context = multiprocessing.get_context("fork")
        for what in uses:
            process = context.Process(target=child, args=(node, broadcaster, what))
            process.start()
            process.join(WITHIN_S)
            print(f"child ended: {process.exitcode}", flush=True)
        print("parent runs:", node.wait(0.01), flush=True)
        answer = buffer.lookup_transform("map", "robot", time.time_ns(), timeout_s=WITHIN_S)
        print("parent hears", answer.child_frame_id, flush=True)
    print("parent closed", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
