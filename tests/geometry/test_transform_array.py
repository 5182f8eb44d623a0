"""Arrays of transforms compute as single transforms do, row by row."""

import copy
import json
import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.builders import transforms
from tfbus import Transform, TransformArray
from tfbus.base.errors import InvalidArgumentException

rows = st.lists(transforms(), min_size=1, max_size=5)
pairs = st.lists(st.tuples(transforms(), transforms()), min_size=1, max_size=5)
ratios = st.floats(0.0, 1.0)
moved_infinitely = [(1, 0, 0, np.inf), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1)]


def same(array: TransformArray, singles: list[Transform], atol: float = 1e-12) -> bool:
    return all(mine.is_close(single, atol) for mine, single in zip(array, singles, strict=True))


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
        singles = list(array)
        of_rows = [single.as_euler(axes) for single in singles]
        assert np.allclose(
            np.exp(1j * array.as_euler(axes)), np.exp(1j * np.array(of_rows)), rtol=0.0, atol=1e-9
        )
        assert same(TransformArray.from_euler(axes, array.as_euler(axes)), singles, 1e-9)


def test_half_turns_come_back_from_matrices():
    """The largest component of each is divided by, whichever it is."""
    half_turns = TransformArray.from_rotvec(np.pi * np.vstack((np.eye(3), [(0.6, 0.8, 0.0)])))
    back = TransformArray.from_matrix(half_turns.as_matrix())
    assert same(back, list(half_turns))


@given(pairs, ratios)
def test_what_lies_between_is_that_of_the_rows(chosen, ratio):
    """Both ways to interpolate take one ratio, or one for each row."""
    a, b = (TransformArray.of(column) for column in zip(*chosen, strict=True))
    # At half a turn there are two short ways round.
    clear = np.linalg.norm((a.inverse() @ b).as_rotvec(), axis=1) < 3.14
    a, b = a[clear], b[clear]
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
    singles = list(array)
    assert same(TransformArray.from_scipy(array.as_scipy_rotation(), array.xyz), singles)
    if hasattr(spatial, "RigidTransform"):
        assert same(TransformArray.from_scipy(array.as_scipy()), singles)


# In the manner of a sequence and of numpy

TRACK = TransformArray.from_rpy(
    [(0.1 * i, 0.0, 0.3 * i) for i in range(8)], xyz=[(i, 2.0 * i, 0.0) for i in range(8)]
)


def test_it_is_a_sequence_of_transforms():
    """len, index, iteration, `in`, reversed: all are of N transforms."""
    singles = [TRACK[i] for i in range(8)]
    assert (len(TRACK), list(TRACK), TRACK[-1]) == (8, singles, singles[7])
    assert list(reversed(TRACK)) == singles[::-1]
    assert singles[3] in TRACK and TRACK.index(singles[3]) == 3
    assert TransformArray.of(TRACK) == TransformArray.of(singles) == TRACK
    assert TRACK.row(2) == TRACK[np.int64(2)] == singles[2]


def test_slices_masks_and_indices_are_arrays():
    """As of numpy."""
    singles = list(TRACK)
    assert list(TRACK[2:4]) == singles[2:4]
    assert list(TRACK[::-1]) == singles[::-1]
    assert list(TRACK[[0, 5]]) == list(TRACK.rows(np.array([0, 5]))) == [singles[0], singles[5]]
    assert list(TRACK[TRACK.xyz[:, 0] > 5.0]) == singles[6:]
    assert len(TRACK[[]]) == 0


@pytest.mark.parametrize("rows", [8, -9, (0, 1), "xyz", None, np.array([[0]]), np.array([True])])
def test_what_picks_no_rows_is_an_index_error(rows):
    """As of numpy; columns are those of the arrays."""
    with pytest.raises(IndexError):
        TRACK[rows]


def test_equal_is_equal_in_all_rows():
    """One bool, also where rows are unknown; arrays can change, so they are no keys."""
    other = copy.deepcopy(TRACK)
    assert other == TRACK and pickle.loads(pickle.dumps(TRACK)) == TRACK
    other.xyz[3, 0] += 1e-9
    assert other != TRACK and TRACK[:3] != TRACK[:4] and list(TRACK) != TRACK
    unknown = TransformArray(np.full((2, 3), np.nan), np.full((2, 4), np.nan))
    assert unknown == copy.copy(unknown)
    with pytest.raises(TypeError, match="unhashable"):
        hash(TRACK)


def test_the_repr_shows_a_few_rows():
    """First and last, as numpy; all of a few."""
    long = TransformArray.concatenate([TRACK] * 25)
    assert repr(long).startswith("TransformArray of 200, x y z")
    assert len(repr(long).splitlines()) == 8 and " ..." in repr(long).splitlines()
    assert len(repr(TRACK[:6]).splitlines()) == 7 and "..." not in repr(TRACK[:6])
    assert repr(TransformArray(np.array([[1.5, 0, 0]]))) == (
        "TransformArray of 1, x y z qx qy qz qw:\n[[1.5 0.  0.  0.  0.  0.  1. ]]"
    )
    assert repr(TRACK[:0]) == "TransformArray of 0"


def test_arrays_join_into_one():
    """Parts are arrays and single transforms; none is an empty array."""
    joined = TransformArray.concatenate([TRACK[:2], TRACK[2], TRACK[3:]])
    assert joined == TRACK
    assert len(TransformArray.concatenate([])) == 0
    assert np.asarray(TRACK).shape == np.stack(list(TRACK)).shape == (8, 4, 4)
    assert np.concatenate([TRACK, TRACK], dtype=np.float32).shape == (16, 4, 4)


@given(pairs)
def test_distances_angles_and_closeness_are_those_of_the_rows(chosen):
    """Row by row, or all against a single transform; ~ inverts."""
    a, b = (TransformArray.of(column) for column in zip(*chosen, strict=True))
    one = chosen[0][1]
    assert np.allclose(a.distance(b), [x.distance(y) for x, y in chosen])
    assert np.allclose(a.angle(b), [x.angle(y) for x, y in chosen], atol=1e-9)
    assert np.allclose(a.angle(one, degrees=True), [x.angle(one, degrees=True) for x in a])
    assert a.is_close(b).tolist() == [x.is_close(y) for x, y in chosen]
    assert a.is_close(a).all()
    assert ~a == a.inverse()


def test_degrees_quaternions_and_matrices_are_those_of_the_rows():
    """The keyword and the orders mean what they mean of one."""
    rpy = [(10.0, -20.0, 90.0), (0.0, 45.0, 180.0)]
    array = TransformArray.from_rpy(rpy, (1, 2, 3), degrees=True)
    singles = [Transform.from_rpy(*each, (1, 2, 3), degrees=True) for each in rpy]
    assert same(array, singles)
    assert np.allclose(array.as_rpy(degrees=True)[0], rpy[0])
    assert np.allclose(
        array.as_euler("ZYX", degrees=True), [s.as_euler("ZYX", degrees=True) for s in singles]
    )
    vectors = array.as_rotvec(degrees=True)
    assert same(TransformArray.from_rotvec(vectors, array.xyz, degrees=True), singles, 1e-9)
    assert same(TransformArray.from_quat_wxyz(array.quat_wxyz, array.xyz), singles)
    assert np.allclose(array.quat_wxyz, [single.quat_wxyz for single in singles])
    rotations = np.asarray(array)[:, :3, :3]
    assert same(TransformArray.from_matrix(rotations, array.xyz), singles)
    assert same(TransformArray.from_matrix(np.asarray(array)[:, :3]), singles)


def test_points_go_through_the_operator():
    """Point i through transform i, or one point through all."""
    points = np.arange(24.0).reshape(8, 3)
    assert np.array_equal(TRACK @ points, TRACK.apply(points))
    assert np.allclose(TRACK @ (1, 0, 0), [T @ (1, 0, 0) for T in TRACK])
    assert np.allclose(TRACK[:1] @ points, TRACK[0] @ points)
    with pytest.raises(InvalidArgumentException, match="8 transforms but 5 points"):
        TRACK @ points[:5]
    with pytest.raises(InvalidArgumentException, match=r"expected points .* got \(4, 4\)"):
        TRACK @ np.eye(4)
    with pytest.raises(InvalidArgumentException, match="the points come second"):
        points @ TRACK
    with pytest.raises(InvalidArgumentException, match="8 transforms but 3 others"):
        TRACK @ TRACK[:3]


def test_one_pair_has_many_ratios():
    """Two poses, N ratios: N poses between them."""
    start, end = TRACK[:1], TRACK[5]
    ratios = [0.0, 0.25, 1.0]
    assert same(start.interpolate(end, ratios), [TRACK[0].interpolate(end, r) for r in ratios])
    assert same(
        start.interpolate_screw(end, ratios), [TRACK[0].interpolate_screw(end, r) for r in ratios]
    )
    with pytest.raises(InvalidArgumentException, match="8 transforms but 3 ratios"):
        TRACK.interpolate(end, ratios)


def test_many_look_at_one_and_one_at_many():
    """Each row is what it is alone."""
    eyes, target = [(1.0, 0, 0), (0, 2.0, 0), (0, 0.1, 3.0)], (0.0, 0, 1.0)
    for convention in ("robot", "camera"):
        many = TransformArray.look_at(eyes, target, convention=convention)
        assert same(many, [Transform.look_at(eye, target, convention=convention) for eye in eyes])
    assert same(
        TransformArray.look_at(target, eyes), [Transform.look_at(target, eye) for eye in eyes]
    )
    with pytest.raises(InvalidArgumentException, match="3 eyes but 2 targets"):
        TransformArray.look_at(eyes, eyes[:2])


def test_json_brings_arrays_back():
    """To the last bit, none too."""
    for array in (TRACK, TRACK[:0]):
        assert TransformArray.from_dict(json.loads(json.dumps(array.to_dict()))) == array


def test_a_constructor_takes_one_row_for_all():
    """A translation for all rotations, a rotation for all translations; quaternions are made unit
    ones, as of a single transform.
    """
    assert TransformArray(np.zeros((2, 3))) == TransformArray.of([Transform()] * 2)
    assert len(TransformArray((1, 2, 3), np.tile((0, 0, 0, 1), (5, 1)))) == 5
    nearly = (0.0, 0.0, 0.6, 0.801)
    assert TransformArray([(1, 2, 3)], nearly).is_close(Transform((1, 2, 3), nearly)).all()


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: TransformArray((1, 2, 3)), r"xyz: expected shape \(N, 3\), got \(3,\)"),
        (lambda: TransformArray(np.zeros((2, 3)), np.zeros((3, 4))), "2 rows, quat_xyzw 3"),
        (lambda: TransformArray([(0, 0, 0)] * 2, [(0, 0, 0, 1), (0, 0, 0, 2)]), "row 1: .* norm 2"),
        (lambda: TransformArray([(0, 0, np.nan)]), "row 0: xyz .* finite"),
        (lambda: TransformArray("abc"), "xyz: expected an array of numbers, got 'abc'"),
        (lambda: TransformArray.of([1]), "transforms: expected a tfbus.Transform, got int"),
        (lambda: TransformArray.concatenate([[1]]), "expected a TransformArray or Transform"),
        (lambda: TRACK.distance(None), "other: expected a TransformArray or Transform, got None"),
    ],
)
def test_what_is_no_array_of_transforms_is_refused(make, says):
    """The row is named, and what was expected."""
    with pytest.raises(InvalidArgumentException, match=says):
        make()


def test_an_unknown_row_is_refused_where_it_is_used():
    """Rows of NaN come of lookup_known_transforms: they are skipped by its mask."""
    unknown = TransformArray(
        np.vstack((TRACK.xyz[:1], np.full((1, 3), np.nan))),
        np.vstack((TRACK.quat_xyzw[:1], np.full((1, 4), np.nan))),
    )
    assert unknown[0] == TRACK[0]
    with pytest.raises(InvalidArgumentException, match="this transform is unknown"):
        unknown[1]
    with pytest.raises(InvalidArgumentException, match="this transform is unknown"):
        list(unknown)
