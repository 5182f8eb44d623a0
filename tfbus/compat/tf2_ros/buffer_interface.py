"""ROS's tf2_ros.buffer_interface: `transform` of stamped objects, and of types of one's own."""

from collections.abc import Callable
from copy import deepcopy
from typing import Any, ClassVar

from tfbus.compat.rclpy.duration import Duration
from tfbus.ros.transforms import Header

__all__ = [
    "BufferInterface",
    "ConvertRegistration",
    "NotImplementedException",
    "Stamped",
    "TransformRegistration",
    "TypeException",
    "convert",
]

DoTransform = Callable[[Any, Any], Any]


class TypeException(Exception):
    """No function is registered for a type."""

    def __init__(self, errstr: str) -> None:
        super().__init__(errstr)
        self.errstr = errstr


class NotImplementedException(Exception):
    """A subclass of BufferInterface has no lookup of its own."""

    def __init__(self) -> None:
        self.errstr = "CanTransform or LookupTransform not implemented"
        super().__init__(self.errstr)


class TransformRegistration:
    """The functions that transform objects, by their type; one table for all buffers."""

    _functions: ClassVar[dict[type, DoTransform]] = {}

    def add(self, key: type, callback: DoTransform) -> None:
        """Transform objects of this type by `callback(object, transform)`."""
        self._functions[key] = callback

    def get(self, key: type) -> DoTransform:
        """The function of a type; a message of ROS itself has that of the same name here.

        Raises TypeException if there is none.
        """
        if key in self._functions:
            return self._functions[key]
        package = key.__module__.partition(".")[0]
        for known, callback in self._functions.items():
            if known.__module__ == f"tfbus.compat.{package}.msg" and known.__name__ == key.__name__:
                return callback
        raise TypeException(
            f"no function transforms a {key.__name__}: import tfbus.compat.tf2_geometry_msgs for "
            "those of geometry_msgs, or register one, "
            f"TransformRegistration().add({key.__name__}, do_transform)"
        )

    def print_me(self) -> None:
        """Print the table."""
        print(self._functions)


class ConvertRegistration:
    """The functions that `convert` uses, by types; one table for all."""

    _to_msg: ClassVar[dict[Any, Callable[[Any], Any]]] = {}
    _from_msg: ClassVar[dict[Any, Callable[[Any], Any]]] = {}
    _convert: ClassVar[dict[Any, Callable[[Any], Any]]] = {}

    def add_to_msg(self, key: type, callback: Callable[[Any], Any]) -> None:
        """Make a message of an object of this type."""
        self._to_msg[key] = callback

    def add_from_msg(self, key: type, callback: Callable[[Any], Any]) -> None:
        """Make an object of this type of a message."""
        self._from_msg[key] = callback

    def add_convert(self, key: tuple[type, type], callback: Callable[[Any], Any]) -> None:
        """Make an object of the second type of one of the first, without a message between."""
        self._convert[key] = callback

    def get_to_msg(self, key: type) -> Callable[[Any], Any]:
        """The function. Raises TypeException if there is none."""
        return _found(self._to_msg, key, "add_to_msg")

    def get_from_msg(self, key: type) -> Callable[[Any], Any]:
        """The function. Raises TypeException if there is none."""
        return _found(self._from_msg, key, "add_from_msg")

    def get_convert(self, key: tuple[type, type]) -> Callable[[Any], Any]:
        """The function. Raises TypeException if there is none."""
        return _found(self._convert, key, "add_convert")


def convert(a: Any, b_type: type) -> Any:
    """The object as another type; a copy of it if it is of that type.

    Raises TypeException if no functions are registered.
    """
    registration = ConvertRegistration()
    direct = registration._convert.get((type(a), b_type))
    if direct is not None:
        return direct(a)
    if type(a) is b_type:
        return deepcopy(a)
    return registration.get_from_msg(b_type)(registration.get_to_msg(type(a))(a))


def Stamped(obj: Any, stamp: Any, frame_id: str) -> Any:
    """The object, with a header of this stamp and frame."""
    obj.header = Header(stamp=stamp, frame_id=frame_id)
    return obj


class BufferInterface:
    """An object with lookups, which so can transform stamped objects.

    A subclass has `lookup_transform`, `lookup_transform_full`, `can_transform` and
    `can_transform_full`. `registration` is the table of types that `transform` takes.
    """

    def __init__(self) -> None:
        self.registration = TransformRegistration()

    def transform(
        self,
        object_stamped: Any,
        target_frame: str,
        timeout: Any = Duration(),  # noqa: B008  # it never changes
        new_type: type | None = None,
    ) -> Any:
        """The object in the target frame, at the time of its header.

        Waits and raises as `lookup_transform`; TypeException for an unknown type.
        """
        do_transform = self.registration.get(type(object_stamped))
        header = object_stamped.header
        found = self.lookup_transform(target_frame, header.frame_id, header.stamp, timeout)
        transformed = do_transform(object_stamped, found)
        return transformed if new_type is None else convert(transformed, new_type)

    def transform_full(
        self,
        object_stamped: Any,
        target_frame: str,
        target_time: Any,
        fixed_frame: str,
        timeout: Any = Duration(),  # noqa: B008  # it never changes
        new_type: type | None = None,
    ) -> Any:
        """The object in the target frame as that was at another time."""
        do_transform = self.registration.get(type(object_stamped))
        header = object_stamped.header
        found = self.lookup_transform_full(
            target_frame, target_time, header.frame_id, header.stamp, fixed_frame, timeout
        )
        transformed = do_transform(object_stamped, found)
        return transformed if new_type is None else convert(transformed, new_type)

    def lookup_transform(self, *arguments: Any, **named: Any) -> Any:
        """Of a subclass."""
        raise NotImplementedException

    def lookup_transform_full(self, *arguments: Any, **named: Any) -> Any:
        """Of a subclass."""
        raise NotImplementedException

    def can_transform(self, *arguments: Any, **named: Any) -> Any:
        """Of a subclass."""
        raise NotImplementedException

    def can_transform_full(self, *arguments: Any, **named: Any) -> Any:
        """Of a subclass."""
        raise NotImplementedException


def _found(table: dict[Any, Callable[[Any], Any]], key: Any, adder: str) -> Callable[[Any], Any]:
    if key not in table:
        raise TypeException(
            f"no function converts {key}: register one, ConvertRegistration().{adder}(...)"
        )
    return table[key]
