"""Arrays of transforms do what single transforms do, row by row."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.builders import transforms
from tfbus import Transform, TransformArray
from tfbus.errors import InvalidArgumentException

rows = st.lists(transforms(), min_size=1, max_size=5)
pairs = st.lists(st.tuples(transforms(), transforms()), min_size=1, max_size=5)
ratios = st.floats(0.0, 1.0)
moved_infinitely = [(1, 0, 0, np.inf), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1)]


def same(array: TransformArray, singles: list[Transform], atol: float = 1e-12) -> bool:
    assert len(array.xyz) == len(singles)
    return all(array.row(i).is_close(single, atol) for i, single in enumerate(singles))


@given(pairs)
def test_products_and_inverses_are_those_of_the_rows(chosen):
    """`a @ b` composes row by row, and a single transform goes with each row, on either side."""
    a, b = (TransformArray.of(column) for column in zip(*chosen, strict=True))
    one = chosen[0][0]
    assert same(a @ b, [x @ y for x, y in chosen], 1e-11)
    assert same(one @ b, [one @ y for _, y in chosen], 1e-11)
    assert same(a @ one, [x @ one for x, _ in chosen], 1e-11)
    assert same(a.inverse(), [x.inverse() for x, _ in chosen], 1e-11)


@given(rows)
def test_conversions_are_those_of_the_rows(singles):
    """Matrices, angles, rotation vectors and twists are those of each transform, and lead back."""
    array = TransformArray.of(singles)
    matrices = [single.as_matrix() for single in singles]
    assert np.allclose(array.as_matrix(), matrices, rtol=0.0, atol=1e-12)
    for axes in ("xyz", "ZYX", "zxz", "XZX"):
        angles = [single.as_euler(axes) for single in singles]
        # Half a turn may have either sign.
        turned = np.exp(1j * array.as_euler(axes)), np.exp(1j * np.array(angles))
        assert np.allclose(*turned, rtol=0.0, atol=1e-7)
        made = TransformArray.from_euler(axes, angles, array.xyz)
        assert same(
            made,
            [Transform.from_euler(axes, a, s.xyz) for a, s in zip(angles, singles, strict=True)],
        )
    assert np.array_equal(array.as_rpy(), array.as_euler("xyz"))
    assert np.allclose(array.as_rotvec(), [single.as_rotvec() for single in singles], atol=1e-12)
    assert np.allclose(array.log(), [single.log() for single in singles], atol=1e-11)
    assert same(TransformArray.from_matrix(array.as_matrix()), singles, 1e-9)
    assert same(TransformArray.from_euler("ZYX", array.as_euler("ZYX"), array.xyz), singles, 1e-7)
    assert same(TransformArray.from_rotvec(array.as_rotvec(), array.xyz), singles)
    assert same(TransformArray.exp(array.log()), singles, 1e-11)


def test_angles_in_gimbal_lock_are_those_of_the_rows():
    """Where an outer angle is free it is the same that is 0, also for half turns."""
    quarters = [-np.pi, -np.pi / 2, 0.0, np.pi / 2, np.pi]
    angles = np.array([(a, b, 0.3) for a in quarters for b in quarters])
    for axes in ("xyz", "ZYX", "zyz", "XYX"):
        array = TransformArray.from_euler(axes, angles)
        singles = [array.row(i) for i in range(len(angles))]
        of_rows = [single.as_euler(axes) for single in singles]
        assert np.allclose(
            np.exp(1j * array.as_euler(axes)), np.exp(1j * np.array(of_rows)), rtol=0.0, atol=1e-9
        )
        assert same(TransformArray.from_euler(axes, array.as_euler(axes)), singles, 1e-9)


def test_half_turns_come_back_from_matrices():
    """The largest component of each is divided by, whichever it is."""
    half_turns = TransformArray.from_rotvec(np.pi * np.vstack((np.eye(3), [(0.6, 0.8, 0.0)])))
    back = TransformArray.from_matrix(half_turns.as_matrix())
    assert same(back, [half_turns.row(i) for i in range(4)])


@given(pairs, ratios)
def test_what_lies_between_is_that_of_the_rows(chosen, ratio):
    """Both ways to interpolate take one ratio, or one for each row."""
    a, b = (TransformArray.of(column) for column in zip(*chosen, strict=True))
    # At half a turn there are two short ways round.
    clear = np.linalg.norm((a.inverse() @ b).as_rotvec(), axis=1) < 3.14
    a, b = a.rows(clear), b.rows(clear)
    chosen = [pair for pair, well in zip(chosen, clear, strict=True) if well]
    each = np.full(len(chosen), ratio)
    assert same(a.interpolate(b, ratio), [x.interpolate(y, ratio) for x, y in chosen], 1e-10)
    assert same(
        a.interpolate_screw(b, each), [x.interpolate_screw(y, ratio) for x, y in chosen], 1e-10
    )


def test_points_and_vectors_go_by_rows():
    """Point i is moved by transform i; a vector is turned only."""
    array = TransformArray.from_rpy([(0, 0, 0), (0, 0, np.pi / 2)], xyz=(1, 0, 0))
    assert np.allclose(array.apply([(1, 0, 0), (1, 0, 0)]), [(2, 0, 0), (1, 1, 0)])
    assert np.allclose(array.rotate([(1, 0, 0), (1, 0, 0)]), [(1, 0, 0), (0, 1, 0)])


def test_no_transform_at_all_is_an_array_too():
    """Arrays may be empty."""
    nothing = TransformArray.of([])
    assert nothing.as_rpy().shape == nothing.as_rotvec().shape == (0, 3)
    assert (nothing @ nothing).log().shape == (0, 6)
    assert len(TransformArray.from_matrix(nothing.as_matrix()).xyz) == 0


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: TransformArray.exp([1.0] * 6), r"twists: expected shape \(N, 6\), got \(6,\)"),
        (
            lambda: TransformArray.from_matrix(np.eye(4)),
            r"expected shape \(N, 4, 4\), .* or \(N, 3, 3\), got \(4, 4\)",
        ),
        (lambda: TransformArray.from_matrix([np.eye(4), -np.eye(4)]), "the last row of the matrix"),
        (lambda: TransformArray.from_matrix([np.full((4, 4), np.nan)]), "last row"),
        (lambda: TransformArray.from_matrix([moved_infinitely]), "finite"),
        (lambda: TransformArray.from_rpy([(0, 0, 0), (0, np.nan, 0)]), "finite"),
        (
            lambda: TransformArray.from_matrix([np.diag((1, 1, -1, 1))]),
            r"\(3, 3\) part of the matrix is not a rotation",
        ),
        (
            lambda: TransformArray.from_rpy([(0, 0, 0)], xyz=[(0, 0, 0)] * 2),
            r"got \(2, 3\)",
        ),
    ],
)
def test_what_cannot_be_is_refused(make, says):
    """An array of another shape is refused, and the expected one named; so is a matrix that
    is no rigid motion.
    """
    with pytest.raises(InvalidArgumentException, match=says):
        make()


def test_scipy_goes_in_and_out_as_arrays():
    """Rotations and rigid transforms of scipy convert both ways, where scipy is there."""
    spatial = pytest.importorskip("scipy.spatial.transform", reason="needs scipy")
    array = TransformArray.from_rpy([(0.1, 0.2, 0.3), (1.0, -1.0, 2.0)], xyz=[(1, 2, 3), (4, 5, 6)])
    singles = [array.row(0), array.row(1)]
    assert same(TransformArray.from_scipy(array.as_scipy_rotation(), array.xyz), singles)
    if hasattr(spatial, "RigidTransform"):
        assert same(TransformArray.from_scipy(array.as_scipy()), singles)
