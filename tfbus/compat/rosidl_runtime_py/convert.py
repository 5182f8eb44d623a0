"""ROS's rosidl_runtime_py.convert: messages as maps, YAML and CSV."""

from collections import OrderedDict
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from tfbus.ros.message_classes import RosMessage

__all__ = [
    "get_message_slot_types",
    "message_to_csv",
    "message_to_ordereddict",
    "message_to_yaml",
]


def message_to_ordereddict(
    msg: Any, *, truncate_length: int | None = None, no_arr: bool = False, no_str: bool = False
) -> "OrderedDict[str, Any]":
    """The fields by name, arrays as lists; of long ones and long texts the first `truncate_length`
    items. With `no_arr` and `no_str` only the lengths of arrays and texts.
    """
    fields: OrderedDict[str, Any] = _ShownParts(truncate_length, no_arr, no_str).message(msg)
    return fields


def message_to_yaml(
    msg: Any,
    *,
    truncate_length: int | None = None,
    no_arr: bool = False,
    no_str: bool = False,
    flow_style: bool = False,
) -> str:
    """The message as YAML, in one line with `flow_style`; options as of the map."""
    import yaml  # slow

    values = _plain(_ShownParts(truncate_length, no_arr, no_str).message(msg))
    text: str = yaml.safe_dump(
        values,
        allow_unicode=True,
        default_flow_style=flow_style,
        sort_keys=False,
        width=float("inf"),
    )
    return text


def message_to_csv(
    msg: Any, *, truncate_length: int | None = None, no_arr: bool = False, no_str: bool = False
) -> str:
    """All values in one line, with commas; the options of `message_to_ordereddict`."""
    values = _ShownParts(truncate_length, no_arr, no_str).message(msg)
    return ",".join(str(each) for each in _leaves(values))


def get_message_slot_types(msg: Any) -> "OrderedDict[str, str]":
    """The types of the fields by name, as ROS calls them."""
    return OrderedDict(msg.get_fields_and_field_types())


@dataclass(frozen=True)
class _ShownParts:
    """The part of a message that is shown."""

    most: int | None
    no_arrays: bool
    no_texts: bool

    def message(self, message: Any) -> "OrderedDict[str, Any]":
        types = message.get_fields_and_field_types()
        values = ((name, getattr(message, name)) for name in types)
        return OrderedDict((name, self._value(value, types[name])) for name, value in values)

    def _value(self, value: Any, shown: str) -> Any:
        if isinstance(value, RosMessage):
            return self.message(value)
        if isinstance(value, bytes):
            return self._text("".join(map(chr, value)))
        if isinstance(value, str):
            return self._text(value)
        if not hasattr(value, "__iter__"):
            return value
        if self.no_arrays:
            if shown.endswith("]"):
                return f"<array type: {shown}>"
            item = shown.removeprefix("sequence<").rstrip(">").partition(",")[0]
            return f"<sequence type: {item}, length: {len(value)}>"
        values = value.tolist() if hasattr(value, "tolist") else list(value)
        cut = [self._value(each, "") for each in values[: self.most]]
        return cut if self.most is None or len(values) <= self.most else [*cut, "..."]

    def _text(self, text: str) -> str:
        if self.no_texts:
            return f"<string length: <{len(text)}>>"
        if self.most is not None and len(text) > self.most:
            return f"{text[: self.most]}..."
        return text


def _plain(value: Any) -> Any:
    """Without OrderedDict, which YAML does not know."""
    if isinstance(value, dict):
        return {name: _plain(each) for name, each in value.items()}
    return [_plain(each) for each in value] if isinstance(value, list) else value


def _leaves(value: Any) -> Iterator[Any]:
    if isinstance(value, dict | list):
        for each in value.values() if isinstance(value, dict) else value:
            yield from _leaves(each)
    else:
        yield value
