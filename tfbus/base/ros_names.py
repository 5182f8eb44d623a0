"""Names of ROS that a program tries here, and what does the same: for the errors of such calls.

The errors get their notes on the way out: as they leave a node's `with`, and before the log shows a
callback's. With a `__getattr__` of its own each call of a buffer would take 80 ns more.
"""

import re
from collections.abc import Mapping

_SEND = {"sendTransform": "send_transform(transforms)"}
_IN_BUFFER = {
    "canTransform": "buffer.can_transform(target, source, stamp_ns)",
    "lookupTransform": "buffer.lookup_transform(target, source, stamp_ns)",
    "waitForTransform": "buffer.lookup_transform(target, source, stamp_ns, timeout_s=1.0)",
}

# By class, and by package: names of ROS, and what does the same here.
_OURS: Mapping[str, Mapping[str, str]] = {
    "tfbus": {
        "Duration": "seconds, as in timeout_s=1.0",
        "Rate": "node.create_timer(period_s, callback), which keeps the rate",
        "Time": "stamps in nanoseconds, as of node.now_ns() or tfbus.stamp_ns(seconds)",
        "init": "tfbus.Node(name), which needs no init",
        "ok": "node.ok",
        "shutdown": "node.close(), or the end of its `with`",
        "spin": "node.spin()",
    },
    "Buffer": _IN_BUFFER
    | {
        "all_frames_as_string": "tfbus.buffer.formats.as_text(buffer.all_frames())",
        "all_frames_as_yaml": "tfbus.buffer.formats.as_yaml(buffer.all_frames())",
        "get_latest_common_time": "buffer.latest_common_time(target, source)",
        "lookup_transform_async": "await buffer.wait_for_transform(target, source, stamp_ns)",
        "set_transform_static": "buffer.set_transform(transform, static=True)",
        "wait_for_transform_async": "await buffer.wait_for_transform(target, source, stamp_ns)",
    },
    "Node": {
        "create_rate": "node.create_timer(period_s, callback), which keeps the rate",
        "destroy_node": "node.close()",
        "get_clock": "node.clock, or node.now_ns()",
        "get_logger": "node.log",
        "get_name": "node.name",
        "get_namespace": "node.namespace",
        "get_parameter": "the Parameter that node.declare_parameter(name, default) returns",
    },
    "StaticTransformBroadcaster": _SEND,
    "Transform": {
        "rotation": "its fields qx, qy, qz and qw, or quat_xyzw",
        "translation": "its fields x, y and z, or xyz",
    },
    "TransformBroadcaster": _SEND,
    "TransformListener": _IN_BUFFER,
    "TransformStamped": {"header": "its fields stamp_ns and frame_id"},
}

# Python names no class of a compiled function.
_LOOKUP = re.compile(
    r"(?:Buffer\.)?(can_transform|lookup_transform)\(\) "
    r"(?:got an unexpected keyword argument 'timeout'|takes (?:at most|from) )"
)


def hint(owner: str, name: str | None) -> str:
    """The end of a sentence about a name that a class, or `tfbus`, has not: `; use: node.log`."""
    ours = _OURS[owner].get(name or "")
    return f"; {_use(ours)}" if ours else ""


def add_note(error: BaseException | None) -> None:
    """Add a note to the error of a call as in ROS that says how it is called here."""
    if isinstance(error, AttributeError):
        note = _on_missing(error.obj, error.name)
    elif isinstance(error, TypeError) and (found := _LOOKUP.match(str(error))):
        note = _use(f"buffer.{found[1]}(target, source, stamp_ns, timeout_s=1.0)")
    else:
        return
    note = note.removeprefix("; ")
    if note and note not in f"{error}{getattr(error, '__notes__', '')}":
        error.add_note(note)


def _use(ours: str) -> str:
    return f"use: {ours}. tfbus.compat has the names of ROS"


def _on_missing(of: object, name: str | None) -> str:
    kinds = (of if isinstance(of, type) else type(of)).__mro__
    if any(str(each.__module__).startswith("tfbus.compat.") for each in kinds):
        return ""  # it has the names of ROS
    ours = [each.__name__ for each in kinds if str(each.__module__).startswith("tfbus.")]
    return next((hint(each, name) for each in ours if each in _OURS), "")
