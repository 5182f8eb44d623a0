"""ROS's rclpy.parameter."""

from enum import IntEnum
from typing import Any

from tfbus.compat.message_classes import message_class
from tfbus.compat.rclpy.type_support import TakesTypes

__all__ = ["Parameter", "ParameterValue"]


class _Type(IntEnum):
    """Types of parameters."""

    NOT_SET = 0
    BOOL = 1
    INTEGER = 2
    DOUBLE = 3
    STRING = 4
    BYTE_ARRAY = 5
    BOOL_ARRAY = 6
    INTEGER_ARRAY = 7
    DOUBLE_ARRAY = 8
    STRING_ARRAY = 9


_SCALARS: dict[type, tuple[_Type, str]] = {
    bool: (_Type.BOOL, "bool"),
    int: (_Type.INTEGER, "integer"),
    float: (_Type.DOUBLE, "double"),
    str: (_Type.STRING, "string"),
}


# A value of each type that a value can be read as.
ZEROS: dict[_Type, Any] = {
    _Type.NOT_SET: None,
    _Type.BOOL: False,
    _Type.INTEGER: 0,
    _Type.DOUBLE: 0.0,
    _Type.STRING: "",
    **{kind: [] for kind in _Type if kind.name.endswith("ARRAY")},
}


class ParameterValue:
    """A value as ROS's message holds it: in the field of its type, the others are empty."""

    def __init__(self, value: Any) -> None:
        self.bool_value, self.integer_value, self.double_value = False, 0, 0.0
        self.string_value = ""
        self.bool_array_value: list[bool] = []
        self.integer_array_value: list[int] = []
        self.double_array_value: list[float] = []
        self.string_array_value: list[str] = []
        self.type = type_of(value)
        if isinstance(value, list):
            setattr(
                self, f"{_SCALARS[type(value[0])][1] if value else 'string'}_array_value", value
            )
        elif value is not None:
            setattr(self, f"{_SCALARS[type(value)][1]}_value", value)


class Parameter(TakesTypes):
    """A parameter of a node, as it is at this moment."""

    Type = _Type

    def __init__(self, name: str, type_: "_Type | None" = None, value: Any = None) -> None:
        found = type_of(value)
        if type_ is not None and value is not None and _Type(type_) == _Type.DOUBLE_ARRAY:
            value, found = [float(each) for each in value], _Type.DOUBLE_ARRAY
        if type_ not in (None, found):
            raise ValueError(f"parameter {name!r} is {found.name} and not {_Type(type_).name}")
        self.name = name
        self.value = value
        self.type_ = found

    @staticmethod
    def from_parameter_msg(param_msg: Any) -> "Parameter":
        """The parameter of a rcl_interfaces.msg.Parameter."""
        type_ = _Type(param_msg.value.type)
        if type_ == _Type.NOT_SET:
            return Parameter(param_msg.name)
        value = getattr(param_msg.value, f"{type_.name.lower()}_value")
        return Parameter(param_msg.name, None, list(value) if type_ > _Type.STRING else value)

    def to_parameter_msg(self) -> Any:
        """It as a rcl_interfaces.msg.Parameter."""
        value = message_class("rcl_interfaces/msg/ParameterValue")(type=int(self.type_))
        if self.type_ != _Type.NOT_SET:
            setattr(value, f"{self.type_.name.lower()}_value", self.value)
        return message_class("rcl_interfaces/msg/Parameter")(name=self.name, value=value)

    def get_parameter_value(self) -> ParameterValue:
        """Its value by type, such as `.string_value`."""
        return ParameterValue(self.value)

    def __repr__(self) -> str:
        return f"Parameter({self.name!r}, {self.type_.name}, {self.value!r})"


def type_of(value: Any) -> _Type:
    """ROS's type of a value. Raises TypeError if it has none."""
    if value is None:
        return _Type.NOT_SET
    if isinstance(value, list | tuple):
        kinds = {type(each) for each in value}
        if len(kinds) > 1 or not kinds <= set(_SCALARS):
            raise TypeError(f"a list of a parameter must be of one type, not {value!r}")
        return _Type(_SCALARS[kinds.pop()][0] + 5) if kinds else _Type.STRING_ARRAY
    if type(value) not in _SCALARS:
        raise TypeError(
            f"a parameter must be a bool, int, float, str or a list of one, not {value!r}"
        )
    return _SCALARS[type(value)][0]
