"""The history of a frame as a ring: samples that leave make room for new ones."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.builders import store_of
from tfbus.base.errors import ExtrapolationException
from tfbus.buffer.buffer import Buffer
from tfbus.geometry.batch import TransformBatch
from tfbus.geometry.sampling import Sampling
from tfbus.geometry.transform import Transform, TransformStamped

MS = 1_000_000
CACHE_MS = 50


def place(t: int, parent: str = "world") -> TransformStamped:
    """Where the robot is at t ms: x is t, and 1000 more below another parent."""
    x = t + (0 if parent == "world" else 1000)
    return TransformStamped(t * MS, parent, "robot", Transform.from_rpy(0, 0, 0.01 * t, (x, 0, 0)))


# Steps of time, some back; the parent; and now and then a sample is looked up, or much forgotten.
STEPS = st.lists(
    st.tuples(
        st.integers(-30, 20),
        st.sampled_from(["world", "world", "world", "world", "dock"]),
        st.sampled_from(["insert", "insert", "insert", "insert", "look", "forget"]),
    ),
    min_size=1,
    max_size=200,
)


@settings(deadline=None)
@given(STEPS)
def test_a_ring_holds_what_a_plain_list_of_the_last_samples_holds(steps):
    """In any order of inserts, late ones, changes of parent and clearings: the same samples."""
    buffer = Buffer(CACHE_MS / 1000)
    held: dict[int, str] = {}
    now = 1000
    docked = False
    for step, parent, action in steps:
        t = max(now + step, 0)
        if action == "forget":
            # A frame that has had another parent of late forgets more.
            if not docked:
                buffer.clear(after_ns=t * MS)
                held = {stamp: above for stamp, above in held.items() if stamp <= t}
                now = max(held, default=now)
            continue
        if action == "insert" and t >= max(held, default=t) - CACHE_MS:
            assert buffer.set_transform(place(t, parent))
            held[t] = parent
            docked = docked or parent == "dock"
            now = max(held)
            held = {stamp: above for stamp, above in held.items() if stamp >= now - CACHE_MS}
        for stamp in (t, min(held, default=t), now):
            parent_then = held.get(stamp)
            if parent_then is not None:
                x = buffer.lookup_transform(parent_then, "robot", stamp * MS).transform.xyz[0]
                assert x == pytest.approx(stamp + (1000 if parent_then == "dock" else 0))
    if held:
        info = buffer.frame("robot")
        assert (info.samples, info.oldest_ns, info.newest_ns) == (
            len(held),
            min(held) * MS,
            max(held) * MS,
        )


def test_a_frame_that_was_reparented_once_is_answered_along_one_path_again():
    """When the samples of the former parent have left, nothing is left of it."""
    buffer = Buffer(CACHE_MS / 1000)
    for t in range(20):
        buffer.set_transform(place(t, "dock"))
    for t in range(20, 200):
        buffer.set_transform(place(t))
        if t == 60:
            assert buffer.lookup_transform("dock", "robot", 15 * MS).transform.xyz[0] == 1015
    with pytest.raises(ExtrapolationException):
        buffer.lookup_transform("world", "robot", 100 * MS)
    assert buffer.lookup_transform("world", "robot", 170 * MS).transform.xyz[0] == 170
    assert store_of(buffer).tree.frames["robot"].parents is None


def chain() -> Buffer:
    """World to tool: an edge that wraps round its ring, one with large turns, a static one."""
    buffer = Buffer(1.0)
    names = ("world", "base", "arm", "tool")
    for i in range(400):
        poses = [
            Transform.from_rpy(0.1, 0.002 * i, 0.01 * i, (0.01 * i, 1, 2)),
            Transform.from_rpy(0.5, 0.9 * i, 0.7 * i, (0.1, 0.02 * i, 0.3)),
        ]
        batch = TransformBatch(
            names,
            np.array([(0, 1), (1, 2)], np.uint32),
            np.array([i * 7 * MS, i * 7 * MS + i % 5 * MS]),
            np.array([pose.as_pose() for pose in poses]),
        )
        assert buffer.set_transforms(batch) == 2
    buffer.set_transform(
        TransformStamped(0, "arm", "tool", Transform.from_rpy(1, 2, 3, (1, 2, 3))), static=True
    )
    return buffer


CHAIN = chain()
LAST = 399 * 7


@settings(deadline=None)
@given(
    st.lists(st.integers((LAST - 1100) * MS, (LAST + 20) * MS), max_size=150),
    st.lists(st.sampled_from([LAST * MS, (LAST - 1000) * MS, (LAST - 7) * MS, 0]), max_size=5),
    st.booleans(),
    st.sampled_from([Sampling(), Sampling("screw")]),
    st.sampled_from([("world", "tool"), ("tool", "world"), ("arm", "base"), ("tool", "tool")]),
)
def test_many_stamps_are_answered_as_each_alone(stamps, edges, in_order, sampling, ends):
    """Whatever their order, twice the same, out of range or at its very ends."""
    asked = [*stamps, *edges, *stamps[:3]]
    if in_order:
        asked.sort()
    many, known = CHAIN.lookup_known_transforms(*ends, np.array(asked, int), sampling=sampling)
    for i, stamp in enumerate(asked):
        try:
            one = CHAIN.lookup_transform(*ends, stamp, sampling=sampling).transform
        except ExtrapolationException:
            assert (
                not known[i] and np.isnan(many.xyz[i]).all() and np.isnan(many.quat_xyzw[i]).all()
            )
        else:
            assert known[i]
            assert np.allclose(many.xyz[i], one.xyz, rtol=0, atol=1e-12)
            assert np.allclose(many.quat_xyzw[i], one.quat_xyzw, rtol=0, atol=1e-12)
