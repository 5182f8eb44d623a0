"""A Struct is like a frozen dataclass with the same lines."""

import copy
import dataclasses
import inspect
import pickle
import subprocess
import sys
from typing import Any, ClassVar

import pytest

from tests import live_bus
from tfbus.base.structs import Struct, field, replace


class Point(Struct):
    """As `DataPoint`."""

    kind: ClassVar[str] = "point"

    x: float
    y: float = 0.0
    tags: list[str] = field(default_factory=list)
    hidden: int = field(default=7, init=False, repr=False, compare=False)


@dataclasses.dataclass(frozen=True)
class DataPoint:
    """As `Point`."""

    kind: ClassVar[str] = "point"

    x: float
    y: float = 0.0
    tags: list[str] = dataclasses.field(default_factory=list)
    hidden: int = dataclasses.field(default=7, init=False, repr=False, compare=False)


class Tally(Struct, frozen=False):
    """Can be changed."""

    count: int = 0


class Handle(Struct, eq=False):
    """Equal to itself only."""

    name: str


class Positive(Struct):
    """Checks its value."""

    value: float

    def __post_init__(self) -> None:
        if self.value <= 0.0:
            raise ValueError("value must be above 0")


@dataclasses.dataclass(frozen=True)
class Labelled(Point):
    """A dataclass that inherits."""

    label: str = "none"


class Farther(Point):
    """A Struct that inherits."""

    z: float = 1.0


@pytest.mark.parametrize(
    ("args", "named"),
    [((1.0,), {}), ((1.0, 2.0), {}), ((), {"y": 3.0, "x": 1.0}), ((1.0,), {"tags": ["a"]})],
)
def test_it_has_the_values_and_the_repr_of_a_dataclass(
    args: tuple[Any, ...], named: dict[str, Any]
) -> None:
    """The same arguments make the same values, in the same order, and the same text."""
    ours, theirs = Point(*args, **named), DataPoint(*args, **named)
    assert vars(ours) | {"hidden": 7} == vars(theirs) | {"hidden": 7}
    assert list(vars(ours))[:3] == ["x", "y", "tags"]
    assert repr(ours) == repr(theirs).removeprefix("Data")


@pytest.mark.parametrize(
    ("args", "named"),
    [((), {}), ((1.0,), {"x": 2.0}), ((1.0,), {"z": 2.0}), ((1.0, 2.0, [], 4), {})],
)
def test_wrong_arguments_are_a_type_error_as_with_a_dataclass(
    args: tuple[Any, ...], named: dict[str, Any]
) -> None:
    """Missing, repeated, unknown and too many arguments raise TypeError."""
    with pytest.raises(TypeError):
        DataPoint(*args, **named)
    with pytest.raises(TypeError, match=r"^Point\(\) "):
        Point(*args, **named)


def test_it_cannot_be_changed() -> None:
    """Setting and deleting raise the error of dataclasses."""
    point = Point(1.0)
    with pytest.raises(dataclasses.FrozenInstanceError, match="assign to field 'x'"):
        point.x = 2.0  # type: ignore[misc]
    with pytest.raises(dataclasses.FrozenInstanceError, match="cannot delete field 'x'"):
        del point.x


def test_equal_values_are_equal_and_have_one_hash() -> None:
    """Values decide, but for those that are not compared; another class is never equal."""
    assert Positive(1.0) == Positive(1.0)
    assert Positive(1.0) != Positive(2.0)
    assert hash(Positive(1.0)) == hash(Positive(1.0))
    assert Point(1.0) != Farther(1.0)
    assert Positive(1.0) != 1.0


def test_one_that_is_not_frozen_can_be_changed_and_has_no_hash() -> None:
    """`frozen=False` is the default of dataclasses."""
    tally = Tally()
    tally.count += 1
    assert tally == Tally(1)
    with pytest.raises(TypeError, match="unhashable"):
        hash(tally)


def test_without_eq_each_is_equal_to_itself_only() -> None:
    """`eq=False` leaves object's comparison and hash."""
    handle = Handle("a")
    assert handle == handle
    assert handle != Handle("a")
    assert len({handle, Handle("a")}) == 2


def test_its_values_are_checked_when_it_is_made_and_when_it_is_replaced() -> None:
    """`__post_init__` runs in both."""
    with pytest.raises(ValueError, match="above 0"):
        Positive(0.0)
    with pytest.raises(ValueError, match="above 0"):
        replace(Positive(1.0), value=-1.0)


def test_a_default_that_is_made_is_made_for_each() -> None:
    """No two share a list."""
    assert Point(1.0).tags is not Point(1.0).tags


def test_the_functions_of_dataclasses_take_it() -> None:
    """`fields`, `replace`, `asdict` and `is_dataclass` answer as for the dataclass."""
    ours, theirs = Point(1.0, tags=["a"]), DataPoint(1.0, tags=["a"])
    assert dataclasses.is_dataclass(ours)
    assert dataclasses.asdict(ours) == dataclasses.asdict(theirs)
    assert dataclasses.replace(ours, y=5.0) == replace(ours, y=5.0) == Point(1.0, 5.0, ["a"])
    for one, other in zip(dataclasses.fields(ours), dataclasses.fields(theirs), strict=True):
        assert (one.name, one.type, one.default, one.init, one.repr, one.compare) == (
            *(other.name, other.type, other.default, other.init, other.repr, other.compare),
        )


def test_its_signature_is_that_of_the_dataclass() -> None:
    """`help` and editors show the same arguments."""
    assert str(inspect.signature(Point)) == str(inspect.signature(DataPoint))


def test_both_kinds_inherit_from_it() -> None:
    """The fields of the base come first."""
    assert repr(Labelled(1.0, label="b")) == "Labelled(x=1.0, y=0.0, tags=[], label='b')"
    assert repr(Farther(1.0)) == "Farther(x=1.0, y=0.0, tags=[], z=1.0)"


def test_copies_are_equal() -> None:
    """By copy, deepcopy and pickle."""
    point = Positive(2.0)
    assert copy.copy(point) == copy.deepcopy(point) == pickle.loads(pickle.dumps(point)) == point


def test_it_matches_by_position() -> None:
    """As a dataclass in `match`."""
    match Point(1.0, 2.0):
        case Point(x, y):
            assert (x, y) == (1.0, 2.0)


@pytest.mark.real
def test_a_node_starts_without_what_is_slow_to_import(bus: live_bus.Bus) -> None:
    """dataclasses takes a third of the time in which a node starts, with inspect, which it
    imports; shutil 3 MB, with bz2 and lzma.
    """
    code = (
        "import sys; from tfbus import Buffer, Node, TransformListener\n"
        "with Node('probe') as node: TransformListener(Buffer(), node)\n"
        "print({'dataclasses', 'inspect', 'ast', 'shutil', 'shlex', 'zlib'} & sys.modules.keys())"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], env=bus.env, capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "set()"


def test_what_dataclasses_asks_for_is_made_once() -> None:
    """To make it takes milliseconds; a class below with more fields has its own."""

    class Named(Point):
        name: str = ""

    assert dataclasses.fields(Point)[0] is dataclasses.fields(Point)[0]
    assert [each.name for each in dataclasses.fields(Named)][-1] == "name"
    assert dataclasses.replace(Named(1.0), name="a").name == "a"
