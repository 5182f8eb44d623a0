"""ROS's rclpy.parameter, and the parameters of a node of rclpy over tfbus's."""

import threading
from collections.abc import Callable, Iterable
from concurrent.futures import Future as Answer
from concurrent.futures import TimeoutError as NotYet
from enum import IntEnum
from typing import Any

from tfbus.base.callbacks import MutuallyExclusiveCallbackGroup
from tfbus.base.errors import ParameterError
from tfbus.compat.rclpy.endpoints import ask_while_spun
from tfbus.compat.rclpy.exceptions import (
    ParameterAlreadyDeclaredException,
    ParameterNotDeclaredException,
    ParameterUninitializedException,
)
from tfbus.compat.rclpy.task import Work
from tfbus.compat.rclpy.type_support import TakesTypes
from tfbus.node.node import Node as TfbusNode
from tfbus.node.parameters import Parameter as TfbusParameter
from tfbus.ros.message_classes import message_class

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


ParameterDescriptor: Any = message_class("rcl_interfaces/msg/ParameterDescriptor")
SetParametersResult: Any = message_class("rcl_interfaces/msg/SetParametersResult")

_SIM_TIME = "use_sim_time"

# How often a change that waits for a callback looks whether the node still lives.
_LOOKS_EVERY_S = 0.5

OnSet = Callable[[list[Parameter]], Any]


class RclpyParameters:
    """The parameters of a node. A parameter without a value exists here only, until it has one."""

    def __init__(self, node: "TfbusNode", work: "Work", *, allow_undeclared: bool) -> None:
        self.callbacks: list[OnSet] = []
        self._node = node
        self._work = work
        self._allow_undeclared = allow_undeclared
        self._declared: dict[str, TfbusParameter | None] = {}
        self._descriptors: dict[str, Any] = {}
        self._setting = threading.local()
        # A change from the bus waits until the node is spun: not on the thread that takes messages.
        self._group = MutuallyExclusiveCallbackGroup()

    def declare(
        self, name: str, value: Any, descriptor: Any, *, ignore_override: bool
    ) -> Parameter:
        """A parameter with a default, or only a type or nothing: then it may have no value."""
        if self.has(name):
            raise ParameterAlreadyDeclaredException(f"{name!r} is declared already")
        if isinstance(value, Parameter.Type):
            value = ZEROS[value] if self._is_given(name) else None
        elif value is None and self._is_given(name):
            value = self._given(name)
        if value is not None and ignore_override and self._is_given(name):
            raise TypeError(
                f"declare_parameter({name!r}, ignore_override=True): the value that was given at "
                "the start counts in tfbus"
            )
        self._descriptors[name] = descriptor or ParameterDescriptor(name=name)
        self._declared[name] = None
        if value is not None:
            self._make(name, value)
        return Parameter(name, None, self._value(name))

    def has(self, name: str) -> bool:
        """Whether it is declared."""
        return name in self._declared or name == _SIM_TIME

    def get(self, name: str) -> Parameter:
        """It as it is now. Raises ParameterNotDeclaredException, or ParameterUninitializedException
        if it has no value.
        """
        if name == _SIM_TIME:
            return Parameter(name, None, self._node.clock.is_simulated)
        if name not in self._declared:
            if self._allow_undeclared:
                return Parameter(name)
            raise ParameterNotDeclaredException(f"{name!r} is not declared")
        value = self._value(name)
        if value is None and not self._descriptors[name].dynamic_typing:
            raise ParameterUninitializedException(f"{name!r} has no value yet")
        return Parameter(name, None, value)

    def with_prefix(self, prefix: str) -> dict[str, Parameter]:
        """The parameters whose names begin with the prefix and a dot, by the rest of the name."""
        before = f"{prefix}." if prefix else ""
        return {
            name.removeprefix(before): Parameter(name, None, self._value(name))
            for name in self._declared
            if name.startswith(before)
        }

    def describe(self, name: str) -> Any:
        """Its descriptor. Raises ParameterNotDeclaredException."""
        if name not in self._declared:
            raise ParameterNotDeclaredException(f"{name!r} is not declared")
        return self._descriptors[name]

    def undeclare(self, name: str) -> None:
        """Forget it here; on the bus it stays as it is."""
        self.describe(name)
        del self._declared[name]

    def set(self, parameter: Parameter) -> Any:
        """Change it; a SetParametersResult says whether, and why not.

        Raises ParameterNotDeclaredException.
        """
        try:
            self._set(parameter)
        except ParameterError as error:
            if parameter.name == _SIM_TIME:
                self._node.log.warning("%s", error)
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _set(self, parameter: Parameter) -> None:
        name, value = parameter.name, parameter.value
        if name == _SIM_TIME:
            if value is not self._node.clock.is_simulated:
                raise ParameterError(
                    "use_sim_time is set when the node starts: --sim-time, TFBUS_SIM_TIME=1, or "
                    "--ros-args -p use_sim_time:=true"
                )
            return
        if name not in self._declared:
            if not self._allow_undeclared:
                raise ParameterNotDeclaredException(f"{name!r} is not declared")
            self._descriptors[name] = ParameterDescriptor(name=name)
            self._declared[name] = None
        declared = self._declared[name]
        if declared is None:
            self._ask([parameter])
            self._make(name, value)
            return
        self._setting.here = True
        try:
            declared.set(list(value) if isinstance(value, tuple) else value)
        finally:
            self._setting.here = False

    def _make(self, name: str, value: Any) -> None:
        value = list(value) if isinstance(value, tuple) else value
        description = getattr(self._descriptors[name], "description", "") or ""

        def on_change(changed: Any) -> None:
            self._on_change(Parameter(name, None, changed))

        self._declared[name] = self._node.declare_parameter(
            name,
            value,
            description=description,
            on_change=on_change,
            callback_group=self._group,
        )

    def _on_change(self, parameter: Parameter) -> None:
        if not self.callbacks:
            return
        if getattr(self._setting, "here", False):
            self._ask([parameter])
            return
        # From the bus: callbacks run while the node is spun.
        reason = self._waited(ask_while_spun(self._work, lambda: self._reason([parameter])))
        if reason is not None:
            raise ParameterError(reason)

    def _waited(self, answer: "Answer[Any]") -> Any:
        while True:
            try:
                return answer.result(_LOOKS_EVERY_S)
            except NotYet:
                if not self._node.ok:
                    raise ParameterError("the node ends") from None

    def _ask(self, parameters: list[Parameter]) -> None:
        if (reason := self._reason(parameters)) is not None:
            raise ParameterError(reason)

    def _reason(self, parameters: list[Parameter]) -> str | None:
        """Why a callback refuses them; None if all take them."""
        for callback in [*self.callbacks]:
            result = callback(parameters)
            if not result.successful:
                return str(result.reason) or "the node refused it"
        return None

    def _value(self, name: str) -> Any:
        declared = self._declared[name]
        return None if declared is None else declared.value

    def _is_given(self, name: str) -> bool:
        return name in self._node.settings.parameters

    def _given(self, name: str) -> Any:
        from tfbus.base.yaml_file import read_value

        return read_value(self._node.settings.parameters[name])


def names_in(parameters: Iterable[Any], prefix: str) -> Iterable[tuple[Any, ...]]:
    """The arguments of each `declare_parameter` of a list: name, and the rest of the entry."""
    before = f"{prefix}." if prefix else ""
    for name, *rest in parameters:
        yield (f"{before}{name}", *rest)
