"""Parameters of a node: values with a type and bounds, changed while the node runs.

A node takes values at its start (`--param name=value`, or a launch file), and on the bus at
`@tfbus/param/<node>/<name>`: a query without payload reads the parameter, one with
`{"value": ...}` sets it; the answer is its description after that. On a closed bus the right to set
is another one than that to read: there it is set at `@tfbus/set/<node>/<name>`.
"""

import logging
import math
import reprlib
from collections.abc import Callable, Iterator, Mapping
from operator import attrgetter
from typing import Any

from tfbus.base.errors import BusError, ParameterError
from tfbus.base.structs import Struct
from tfbus.base.wording import did_you_mean, printable
from tfbus.bus.query import Query, within
from tfbus.bus.session import Session
from tfbus.node.endpoint import Lane
from tfbus.node.service import submit_or_refuse
from tfbus.wire.codec import decode_map, encode_map
from tfbus.wire.keys import (
    check_parameter,
    last_name,
    node_parameters_key,
    node_settings_key,
    parameter_key,
    setting_key,
)

Value = bool | int | float | str | list[Any]

_TYPE_NAMES: dict[type, str] = {
    bool: "boolean",
    int: "integer",
    float: "number",
    str: "text",
    list: "list",
}


class Bounds(Struct):
    """The least and the greatest value of a number, both allowed; None for no bound."""

    minimum: float | None = None
    maximum: float | None = None

    def check(self, name: str, value: object) -> None:
        """Raise ParameterError if the value is outside."""
        if not isinstance(value, int | float):
            return
        if self.minimum is not None and not value >= self.minimum:  # as NaN is not
            raise ParameterError(f"{name!r} must be at least {self.minimum:g}, not {value:g}")
        if self.maximum is not None and not value <= self.maximum:
            raise ParameterError(f"{name!r} must be at most {self.maximum:g}, not {value:g}")


class Parameter:
    """A parameter of a node; `value` is its value now."""

    def __init__(
        self,
        name: str,
        default: Value,
        description: str,
        bounds: Bounds,
        on_change: Callable[[Any], object],
    ):
        if type(default) not in _TYPE_NAMES:
            raise ParameterError(f"a parameter cannot be of type {type(default).__name__}")
        self.name = check_parameter(name)
        if not _fits_the_wire(default):
            raise ParameterError(f"the default of {name!r} cannot be sent: {_shown(default)}")
        bounds.check(name, default)
        self.value: Any = default
        self.description = description
        self._type: type = type(default)
        self._bounds = bounds
        self._on_change = on_change

    def set(self, value: object) -> None:
        """Change the value.

        Raises ParameterError, and changes nothing, if the type is wrong, the value out of
        bounds, or refused by the node.
        """
        checked = self.checked(value)
        self._on_change(checked)
        self.value = checked

    def checked(self, value: Any) -> Any:
        """The value in this parameter's type, read as YAML if it is a text of up to 10,000
        letters.

        Raises ParameterError if the type is wrong or the value out of bounds.
        """
        if isinstance(value, str) and self._type is not str:
            value = _read_text(value)
        if isinstance(value, int) and not isinstance(value, bool) and self._type is float:
            value = _as_float(value)
        if type(value) is not self._type or not _fits_the_wire(value):
            raise ParameterError(
                f"{self.name!r} must be {_with_article(_TYPE_NAMES[self._type])}, not "
                f"{_shown(value)}"
            )
        if isinstance(value, float) and not math.isfinite(value):
            raise ParameterError(f"{self.name!r} must be finite, not {value}")
        self._bounds.check(self.name, value)
        return value

    def describe(self) -> dict[str, Any]:
        """Its description on the bus, the fields of a ParameterDescription."""
        return {
            "name": self.name,
            "value": self.value,
            "type": _TYPE_NAMES[self._type],
            "description": self.description,
            "minimum": self._bounds.minimum,
            "maximum": self._bounds.maximum,
        }


class Parameters:
    """The parameters of one node, served on the bus."""

    def __init__(
        self,
        node: str,
        given: Mapping[str, Any],
        session: Session,
        lane: Lane,
        log: logging.Logger,
    ):
        self._node = node
        self._given = given
        self._lane = lane
        self._lanes: dict[str, Lane] = {}
        self._log = log
        self._parameters: dict[str, Parameter] = {}
        self._is_closed = session.settings.closed is not None
        session.queryable(node_parameters_key(node), self._on_query)
        if self._is_closed:
            session.queryable(node_settings_key(node), self._on_query)

    def __iter__(self) -> Iterator[Parameter]:
        return iter(sorted(self._parameters.values(), key=attrgetter("name")))

    def declare(self, parameter: Parameter, lane: Lane) -> Parameter:
        """Add a parameter, with the value given at the node's start if there is one. It is served
        in the lane, unless several are queried at once.

        Raises ParameterError if the name is declared already, or the given value is invalid.
        """
        if parameter.name in self._parameters:
            raise ParameterError(f"parameter {parameter.name!r} is already declared")
        if parameter.name in self._given:
            parameter.value = parameter.checked(self._given[parameter.name])
        self._lanes[parameter.name] = lane
        self._parameters[parameter.name] = parameter
        return parameter

    def warn_of_undeclared(self) -> None:
        """Warn of each value given at the node's start whose parameter is not declared."""
        for name in sorted(set(self._given) - set(self._parameters)):
            hint = did_you_mean(name, self._parameters, none="; there are none")
            self._log.warning("Parameter %r was given, but not declared by this node%s", name, hint)

    def _on_query(self, query: Query) -> None:
        lane = self._lanes.get(last_name(query.key), self._lane)
        submit_or_refuse(lane, "parameters", self._serve, query)

    def _serve(self, query: Query) -> None:
        with query.answering("the node"):
            is_setting = "@tfbus/set/" in query.key
            key_of = setting_key if is_setting else parameter_key
            asked = self._asked_for(query.key, key_of)
            if payload := query.payload:
                if self._is_closed and not is_setting:
                    raise ParameterError("on a closed bus a parameter is set at its own key")
                values = decode_map(payload)
                for parameter in asked:
                    self._set(parameter, values)
            for parameter in asked:
                key = key_of(self._node, parameter.name)
                query.answer(key, encode_map(parameter.describe()))

    def _asked_for(self, key: str, key_of: Callable[[str, str], str]) -> list[Parameter]:
        asked = [p for p in self if within(key_of(self._node, p.name), key)]
        if not asked and "*" not in key:
            name = last_name(key)
            hint = did_you_mean(name, self._parameters, none="; there are none")
            raise ParameterError(f"{self._node} has no parameter '{printable(name, 60)}'{hint}")
        return asked

    def _set(self, parameter: Parameter, values: dict[str, Any]) -> None:
        if "value" not in values:
            raise ParameterError("set a parameter with a map that has 'value'")
        parameter.set(values["value"])
        self._log.info("Parameter %s is now %s", parameter.name, _shown(parameter.value))


def _read_text(text: str) -> object:
    # YAML, only where a value comes as text
    from tfbus.base.yaml_file import read_strangers_value

    return read_strangers_value(text)


def _as_float(value: int) -> float:
    """The integer as a float, infinite if it is too large for one."""
    try:
        return float(value)
    except OverflowError:
        return math.inf if value > 0 else -math.inf


def _shown(value: object) -> str:
    """The value as a sentence holds it, short."""
    return printable(repr(value[:80]) if isinstance(value, str) else reprlib.repr(value), 80)


def _fits_the_wire(value: Any) -> bool:
    """Whether msgpack can hold the value: no integer of more than 64 bits, no date of YAML's."""
    try:
        encode_map({"value": value})
    except (BusError, OverflowError, TypeError, ValueError):
        return False
    return True


def _with_article(noun: str) -> str:
    return f"an {noun}" if noun[0] in "aeiou" else f"a {noun}"
