"""A batch is columns that agree with each other."""

import numpy as np
import pytest

from tests.builders import at
from tfbus.base.errors import InvalidArgumentException
from tfbus.geometry.batch import TransformBatch
from tfbus.geometry.columns import Columns
from tfbus.geometry.transform import Transform, TransformStamped


def test_what_goes_in_comes_out():
    """A batch of transforms iterates as those transforms, and names each frame once."""
    some = [TransformStamped(i, "world", f"r{i % 2}", Transform((i, 0, 0))) for i in range(4)]
    batch = TransformBatch.from_transforms(some)
    assert list(batch) == some
    assert (len(batch), batch.frames) == (4, ("world", "r0", "r1"))
    assert not batch.poses.flags.writeable
    assert len(TransformBatch.from_transforms([])) == 0


def test_columns_that_do_not_agree_are_refused():
    """Shapes, types and indices are checked when it is made."""
    edges, stamps, poses = np.array([[0, 1]], np.uint32), np.array([1]), np.zeros((1, 7))
    for bad in (
        (("a",), edges, stamps, poses),
        (("a", "b"), edges, np.array([1, 2]), poses),
        (("a", "b"), edges, stamps, np.zeros((1, 6))),
        (("a", "b"), edges, np.array([1.5]), poses),
    ):
        with pytest.raises(InvalidArgumentException):
            TransformBatch(*bad)


def test_a_text_is_no_list_of_names_and_one_stamp_no_column() -> None:
    """Its letters would be frames."""
    edges, poses = np.array([[0, 1]], dtype=np.uint32), np.array([[0, 0, 0, 0, 0, 0, 1.0]])
    with pytest.raises(InvalidArgumentException, match="several names, got a str"):
        TransformBatch("ab", edges, np.array([1]), poses)
    with pytest.raises(InvalidArgumentException, match=r"stamps_ns: expected shape \(1,\)"):
        TransformBatch(("a", "b"), edges, 5, poses)


def test_chosen_rows_are_read_only_too() -> None:
    """As the arrays of any batch."""
    chosen = TransformBatch.from_transforms([at(1.0, "robot", 1)]).only(("robot",))
    with pytest.raises(ValueError, match="read-only"):
        chosen.poses[0, 0] = 2.0


@pytest.mark.parametrize(
    ("transforms", "says"),
    [
        (Transform(), r"got Transform: TransformStamped\(stamp_ns, .* adds its frames"),
        ([Transform()], "got Transform: TransformStamped"),
        ([TransformStamped(0, "a", "b", Transform()), None], "got None"),
        (5, "expected tfbus.TransformStamped, got int"),
    ],
)
@pytest.mark.parametrize("make", [TransformBatch.from_transforms, Columns.of_transforms])
def test_what_is_no_stamped_transform_is_named(make, transforms, says):
    """With what it needs."""
    with pytest.raises(InvalidArgumentException, match=says):
        make(transforms)
