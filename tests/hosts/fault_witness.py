"""A listener for the test of faults: prints its frames, a line of JSON five times a second.

python fault_witness.py NAME
"""

import json
import sys
import threading
from pathlib import Path

from tfbus import Buffer, Node, TransformException, TransformListener

PERIOD_S = 0.2
_NS_PER_S = 1e9


def describe_frame(buffer: Buffer, name: str, now_ns: int) -> dict[str, object]:
    """What the buffer knows of a frame that has a parent."""
    frame = buffer.frame(name)
    known: dict[str, object] = {"gone": frame.gone, "static": frame.static}
    if not frame.static and frame.newest_ns is not None:
        known["newest_ns"] = frame.newest_ns
        known["age_s"] = (now_ns - frame.newest_ns) / _NS_PER_S
    if frame.static and frame.parent is not None:
        try:
            known["x"] = buffer.lookup_transform(frame.parent, name).transform.x
        except TransformException as error:
            known["error"] = str(error)
    return known


def resident_kb() -> int:
    """The memory that this process holds, in kB."""
    status = Path("/proc/self/status").read_text()
    return int(status.split("VmRSS:")[1].split()[0])


def main(name: str) -> None:
    """Tell until a signal."""
    with Node(name) as node:
        buffer = Buffer()
        with TransformListener(buffer, node) as listener:
            while node.wait(PERIOD_S):
                now_ns = node.now_ns()
                report = {
                    "alive": [stream.name for stream in listener.streams() if stream.alive],
                    "frames": {
                        frame: describe_frame(buffer, frame, now_ns)
                        for frame in buffer.frames()
                        if frame != "world"
                    },
                    "resident_kb": resident_kb(),
                    "handles": len(list(Path("/proc/self/fd").iterdir())),
                    "threads": threading.active_count(),
                }
                print(json.dumps(report), flush=True)


if __name__ == "__main__":
    main(sys.argv[1])
