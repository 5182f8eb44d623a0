"""A buffer that passes on the rows that it stores."""

import math

from tests.builders import S, at
from tfbus import TransformBatch, TransformStamped
from tfbus.geometry.columns import Columns
from tfbus.streams.passing_buffer import PassingBuffer


def passed(*batches: list[TransformStamped] | TransformBatch) -> list[list[tuple[str, int]]]:
    """The child and the stamp of each row of each batch that is passed on."""
    found: list[list[tuple[str, int]]] = []

    def take(rows: Columns, static: bool, stream: str) -> None:
        found.append([(each.child_frame_id, each.stamp_ns) for each in rows])

    buffer = PassingBuffer(10.0, on_rows=take)
    for batch in batches:
        buffer.set_transforms(batch)
    return found


def test_rows_that_are_stored_are_passed_on() -> None:
    """All of a message, as a rule."""
    assert passed([at(1.0, "robot", S), at(2.0, "lamp", S)]) == [[("robot", S), ("lamp", S)]]


def test_a_row_that_is_too_old_is_not_passed_on() -> None:
    """The others of its message are."""
    later = [at(1.0, "robot", 20 * S), at(1.0, "lamp", 20 * S)]
    _, second = passed(later, [at(1.0, "robot", 5 * S), at(1.0, "lamp", 21 * S)])
    assert second == [("lamp", 21 * S)]


def test_a_row_that_is_refused_is_not_passed_on() -> None:
    """One that is no transform, or would close a loop."""
    batch = TransformBatch.from_transforms(
        [
            at(1.0, "robot", S),
            at(1.0, "lamp", S),
            at(1.0, "world", S, parent="robot"),
            at(1.0, "arm", S, parent="robot"),
        ]
    )
    poses = batch.poses.copy()
    poses[1, 0] = math.nan
    spoilt = TransformBatch(batch.frames, batch.edges, batch.stamps_ns, poses)
    assert passed(spoilt) == [[("robot", S), ("arm", S)]]
