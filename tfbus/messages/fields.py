"""Checks of the fields of messages, and fields that are arrays of numpy."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cache
from math import isfinite, prod
from typing import TYPE_CHECKING, Any, TypeAlias

from tfbus.base import lazy_numpy as np
from tfbus.base.lazy_numpy import NDArray

_LARGE = 4096

# Where a field with a former name is now, as a path; of a list, a path for each item.
Former = Mapping[str, str | tuple[str, ...]]


@dataclass(frozen=True, slots=True)
class ArrayOf:
    """A field that is an array of numpy: (N,) numbers, or (N, width) with `columns`.

    `kind` is the type of its numbers, by its name in ROS. On the bus it is one binary of these,
    little-endian, row by row. `columns` are the fields of ROS's message for a row, as paths.
    """

    kind: str
    columns: tuple[str, ...] = ()

    def __str__(self) -> str:
        return f"{self.kind} array (N{f', {len(self.columns)}' if self.columns else ','})"

    @property
    def dtype(self) -> str:
        """The type of its numbers as numpy names it, little-endian as on the bus."""
        return _DTYPES[self.kind]

    @property
    def row_size(self) -> int:
        """The bytes of a row."""
        return _SIZES[self.kind] * (len(self.columns) or 1)

    def made(self, value: Any, name: str) -> Any:
        """An array of a value that a program gives the field `name`: it shares its memory if the
        numbers are of this type and lie one behind the other, and cannot be written to.

        Bytes and the like are taken as the numbers' memory. Raises ValueError for another shape,
        and for numbers that this type does not hold.
        """
        if value.__class__ is np.ndarray and self._is_of_this_type(value):
            if value.flags.writeable:
                value = value.view()
                value.setflags(write=False)
            return value
        if isinstance(value, (bytes, bytearray, memoryview)):  # `|` takes longer
            return self.of_memory(value, name)
        given = np.asarray(value)
        if not given.size:
            given = given.reshape(-1, *self._tail).astype(self.dtype)
        if given.ndim != 1 + len(self._tail) or given.shape[1:] != self._tail:
            shape = f"(N{f', {len(self.columns)}' if self.columns else ','})"
            raise ValueError(f"{name} must have the shape {shape}, not {given.shape}")
        array = self._of_this_type(given, name)
        array = np.ascontiguousarray(array).view()
        array.flags.writeable = False
        return array

    def _is_of_this_type(self, array: Any) -> bool:
        """Whether an array has the numbers and the shape of this type, one behind the other."""
        dtype, wanted, columns = array.dtype, _numpy_type(self.kind), self.columns
        return bool(
            (dtype is wanted or dtype == wanted)
            and (array.shape[1:] == (len(columns),) if columns else array.ndim == 1)
            and array.flags.c_contiguous
        )

    def of_memory(self, data: Any, name: str) -> Any:
        """An array on the bytes of another object, which cannot be written to.

        Raises ValueError if they are not whole rows.
        """
        try:
            array = np.frombuffer(data, _numpy_type(self.kind))
            if self.columns:
                array = array.reshape(-1, len(self.columns))
        except ValueError:
            size = memoryview(data).nbytes
            raise ValueError(
                f"{name} must be a multiple of {self.row_size} bytes, of {self.kind}, not {size}"
            ) from None
        if data.__class__ is not bytes:
            array.setflags(write=False)
        return array

    def memory_of(self, array: Any) -> bytes | memoryview:
        """The bytes of an array that this made, as they go over the bus: of a large one its memory,
        of a small one a copy, which is made sooner.
        """
        return memoryview(array).cast("B") if array.nbytes >= _LARGE else array.tobytes()

    @property
    def _tail(self) -> tuple[int, ...]:
        return (len(self.columns),) if self.columns else ()

    def _of_this_type(self, given: Any, name: str) -> Any:
        wanted = _numpy_type(self.kind)
        if given.dtype == wanted:
            return given
        if wanted.kind == "f" and given.dtype.kind in "fiu":
            with np.errstate(over="ignore"):
                array = given.astype(wanted)
            if np.isinf(array).sum() > np.isinf(given).sum():
                raise ValueError(f"{name} has a number that is too large for {self.kind}")
            return array
        if wanted.kind in "iu" and given.dtype.kind in "iu":
            limits = np.iinfo(wanted)
            if int(given.min()) < limits.min or int(given.max()) > limits.max:
                raise ValueError(f"{name} must be from {limits.min} to {limits.max}")
            return given.astype(wanted)
        raise ValueError(f"{name} must be an array of {self.kind}, not of {given.dtype}")


_DTYPES = {
    "int8": "|i1",
    "uint8": "|u1",
    "int16": "<i2",
    "uint16": "<u2",
    "int32": "<i4",
    "uint32": "<u4",
    "int64": "<i8",
    "uint64": "<u8",
    "float32": "<f4",
    "float64": "<f8",
}

_SIZES = {kind: int(dtype[2:]) for kind, dtype in _DTYPES.items()}


@cache
def _numpy_type(kind: str) -> Any:
    return np.dtype(_DTYPES[kind])


_POSE = (*(f"position.{each}" for each in "xyz"), *(f"orientation.{each}" for each in "xyzw"))

# Types of fields: a type checker sees numpy's, and `wire.codec` the numbers on the bus.
if TYPE_CHECKING:
    Int8Array: TypeAlias = NDArray[np.int8]
    UInt8Array: TypeAlias = NDArray[np.uint8]
    Float32Array: TypeAlias = NDArray[np.float32]
    Float64Array: TypeAlias = NDArray[np.float64]
    PointsArray: TypeAlias = NDArray[np.float64]
    Points32Array: TypeAlias = NDArray[np.float32]
    PosesArray: TypeAlias = NDArray[np.float64]
    ColorsArray: TypeAlias = NDArray[np.float32]
    UvArray: TypeAlias = NDArray[np.float32]
else:
    Int8Array = ArrayOf("int8")
    UInt8Array = ArrayOf("uint8")
    Float32Array = ArrayOf("float32")
    Float64Array = ArrayOf("float64")
    PointsArray = ArrayOf("float64", tuple("xyz"))
    Points32Array = ArrayOf("float32", tuple("xyz"))
    PosesArray = ArrayOf("float64", _POSE)
    ColorsArray = ArrayOf("float32", tuple("rgba"))
    UvArray = ArrayOf("float32", tuple("uv"))


def no_numbers() -> Any:
    """An empty array; the constructor makes it one of the field's type."""
    return np.empty(0, np.uint8)


class WithArrays:
    """A message with arrays: two are equal if all their numbers are, and NaN is equal to NaN.

    It has no hash.
    """

    __slots__ = ()

    def _make_arrays(self) -> None:
        """Make arrays of the values given for them. Raises ValueError."""
        for name, kind in _arrays_of(type(self)):  # type: ignore[arg-type]
            object.__setattr__(self, name, kind.made(getattr(self, name), name))

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        return all(
            _are_equal(getattr(self, each.name), getattr(other, each.name))
            for each in fields(self)  # type: ignore[arg-type]
        )

    __hash__ = None  # type: ignore[assignment]


@cache
def _arrays_of(message_type: type) -> tuple[tuple[str, ArrayOf], ...]:
    return tuple(
        (each.name, each.type) for each in fields(message_type) if isinstance(each.type, ArrayOf)
    )


def _are_equal(one: Any, other: Any) -> bool:
    if not hasattr(one, "dtype"):
        return bool(one == other)
    return np.array_equal(one, other, equal_nan=one.dtype.kind == "f")


def check_finite(name: str, value: float) -> None:
    """Raise ValueError for a number that is not finite."""
    if not isfinite(value):
        raise ValueError(f"{name} must be finite, not {value}")


def check_all_finite(name: str, array: Any) -> None:
    """Raise ValueError for an array with a number that is not finite."""
    if not np.isfinite(array).all():
        at = int(np.flatnonzero(~np.isfinite(array).reshape(len(array), -1).all(axis=1))[0])
        raise ValueError(f"{name}[{at}] must be finite, not {array[at]}")


def check_count(name: str, numbers: tuple[float, ...], count: int) -> None:
    """Raise ValueError for another number of numbers."""
    if len(numbers) != count:
        raise ValueError(f"{name} must be {count} numbers, not {len(numbers)}")


def check_stamp(name: str, value: int) -> None:
    """Raise ValueError for a time before 1970 or of more than 63 bits."""
    if not 0 <= value < 2**63:
        raise ValueError(f"{name} must be nanoseconds from 0 to 2^63 - 1, not {value}")


def check_byte(name: str, value: int) -> None:
    """Raise ValueError for an integer that is no byte."""
    if not 0 <= value <= 255:
        raise ValueError(f"{name} must be from 0 to 255, not {value}")


def check_unsigned(name: str, value: int) -> None:
    """Raise ValueError for an integer that does not fit ROS's uint32."""
    if not 0 <= value < 2**32:
        raise ValueError(f"{name} must be from 0 to 2^32 - 1, not {value}")


def check_one_of(name: str, value: Any, allowed: Mapping[Any, str] | tuple[Any, ...]) -> None:
    """Raise ValueError for a value that is none of these, which may have names."""
    if value not in allowed:
        named = (
            allowed.items() if isinstance(allowed, Mapping) else ((each, "") for each in allowed)
        )
        said = ", ".join(f"{each} ({text})" if text else str(each) for each, text in named)
        raise ValueError(f"{name} must be one of {said}, not {str(value)[:60]!r}")


def check_size(name: str, array: Any, *sizes: int, of: str) -> None:
    """Raise ValueError if an array has not as many items as the product of these, which `of` says
    in words.
    """
    expected = prod(sizes)
    if len(array) != expected:
        raise ValueError(f"{name} must have {expected} items, {of}, not {len(array)}")
