"""Recordings of real robots, from the folder that TFBUS_RECORDINGS names. Not a test itself."""

import os
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests import needs
from tests.recording.foreign_files import RawTransform, Sent
from tests.tf2.steps import Insert

RECORDINGS = (
    "long_20hz",
    "pr2_full_tree",
    "turtlebot3_no_static",
    "turtlesim_pair",
    "two_publishers_may16",
    "walker_repeats",
)


def columns(name: str) -> dict[str, NDArray[Any]]:
    """The columns of a recording; the test is skipped where there is none."""
    folder = os.environ.get("TFBUS_RECORDINGS")
    if not folder:
        needs.skip("recordings", "TFBUS_RECORDINGS names no folder of them")
    with np.load(Path(folder) / f"{name}.npz") as found:
        return dict(found)


def inserts(name: str) -> list[Insert]:
    """Its transforms. tf2 strips a leading slash, which robots of ROS 1 still sent; tfbus refuses
    it.
    """
    found = columns(name)
    return [
        Insert(parent.removeprefix("/"), child.removeprefix("/"), stamp_ns, tuple(pose), static)
        for parent, child, stamp_ns, pose, static in zip(
            found["parent"].tolist(),
            found["child"].tolist(),
            found["stamp_ns"].tolist(),
            np.hstack((found["xyz"], found["quat_xyzw"])).tolist(),
            found["static"].tolist(),
            strict=True,
        )
    ]


def sent(name: str) -> list[Sent]:
    """Its messages, names as they were."""
    found = columns(name)
    poses = np.hstack((found["xyz"], found["quat_xyzw"])).tolist()
    parents, children = found["parent"].tolist(), found["child"].tolist()
    stamps, static = found["stamp_ns"].tolist(), found["static"].tolist()
    starts = np.flatnonzero(np.diff(found["msg_index"], prepend=-1)).tolist()
    return [
        Sent(
            int(found["recv_ns"][start]),
            [
                RawTransform(stamps[row], parents[row], children[row], poses[row])
                for row in range(start, end)
            ],
            "/tf_static" if static[start] else "/tf",
        )
        for start, end in pairwise((*starts, len(stamps)))
    ]
