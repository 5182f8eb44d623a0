"""Prints facts of rclpy's classes of interfaces, or tfbus.compat's, as JSON.

Run as `python facts_of_interfaces.py "" std_msgs ...` in ROS; "tfbus.compat." stands for "" here.
"""

import importlib
import json
import sys
from typing import Any

_PARTS = {"msg": (), "srv": ("Request", "Response"), "action": ("Goal", "Result", "Feedback")}


def facts(prefix: str, packages: list[str]) -> dict[str, Any]:
    """Of each message: its fields with their types, a new one as text, and the types of values."""
    found = {}
    for package in packages:
        for kind, parts in _PARTS.items():
            try:
                module = importlib.import_module(f"{prefix}{package}.{kind}")
            except ImportError:
                continue
            for name in dir(module):
                # ROS's modules have the parts of a service beside it too.
                if name[:1].isupper() and "WString" not in name and "_" not in name:
                    holder = getattr(module, name)
                    for made in [getattr(holder, part) for part in parts] or [holder]:
                        found[f"{package}/{kind}/{made.__name__}"] = _of(made)
    return found


def _of(message_type: Any) -> Any:
    fields = message_type.get_fields_and_field_types()
    message = message_type()
    constants = {
        name: repr(getattr(message_type, name))
        for name in dir(message_type)
        if name.isupper() and name != "SLOT_TYPES" and not name.endswith("__DEFAULT")
    }
    kinds = {name: type(getattr(message, name)).__name__ for name in fields}
    return [fields, repr(message), kinds, constants]


if __name__ == "__main__":
    json.dump(facts(sys.argv[1], sys.argv[2:]), sys.stdout, sort_keys=True)
