"""ROS's rosidl_runtime_py: messages from and to maps and texts, and types by their names."""

from collections.abc import Callable
from typing import Any

import pytest

from tfbus.compat import rosidl_runtime_py
from tfbus.compat.builtin_interfaces.msg import Time
from tfbus.compat.geometry_msgs.msg import Polygon, PoseStamped
from tfbus.compat.nav2_msgs.action import Spin
from tfbus.compat.rosidl_runtime_py import (
    message_to_csv,
    message_to_ordereddict,
    message_to_yaml,
    set_message_fields,
)
from tfbus.compat.rosidl_runtime_py.utilities import (
    get_action,
    get_interface,
    get_message,
    get_service,
)
from tfbus.compat.sensor_msgs.msg import JointState
from tfbus.compat.std_srvs.srv import Trigger


def test_fields_are_set_from_a_map() -> None:
    """Fields that it does not name stay, in messages within it too; stamps may be set later."""
    pose = PoseStamped()
    pose.pose.position.y = 2.0
    values = {"header": "auto", "pose": {"position": {"x": 1}}}
    (set_stamp,) = set_message_fields(pose, values, expand_header_auto=True)
    assert (pose.pose.position.x, pose.pose.position.y) == (1.0, 2.0)
    set_stamp(Time(sec=7))
    assert pose.header.stamp.sec == 7
    now = {"header": {"stamp": "now", "frame_id": "map"}}
    (set_stamp,) = set_message_fields(pose, now, expand_time_now=True)
    set_stamp(Time(sec=8))
    assert (pose.header.stamp.sec, pose.header.frame_id) == (8, "map")
    polygon = Polygon()
    set_message_fields(polygon, {"points": [{"x": 1}]})
    assert (polygon.points[0].x, polygon.points[0].z) == (1.0, 0.0)


@pytest.mark.parametrize(
    ("values", "kind", "said"),
    [
        ({"pints": []}, AttributeError, "geometry_msgs/msg/Polygon has no field 'pints'"),
        ({"points": [{"w": 1}]}, ValueError, r"no field 'points\[0\].w'"),
        ({"points": 1}, ValueError, "field 'points' must be a list"),
        (1, TypeError, "expected a map of fields of geometry_msgs/msg/Polygon"),
    ],
)
def test_what_does_not_fit_is_named(values: Any, kind: type[Exception], said: str) -> None:
    """With the field."""
    with pytest.raises(kind, match=said):
        set_message_fields(Polygon(), values)


def test_a_message_is_a_map_and_a_text() -> None:
    """With all fields in order; long arrays and texts may be cut, or left out."""
    joints = JointState(name=["a", "b"], position=[1.0, 2.0])
    joints.header.frame_id = "base"
    header = {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": "base"}
    values = message_to_ordereddict(joints)
    assert values == {
        "header": header,
        "name": ["a", "b"],
        "position": [1.0, 2.0],
        "velocity": [],
        "effort": [],
    }
    assert [*values] == [*JointState.get_fields_and_field_types()]
    assert message_to_ordereddict(joints, truncate_length=1)["name"] == ["a", "..."]
    without = message_to_ordereddict(joints, no_arr=True, no_str=True)
    assert without["position"] == "<sequence type: double, length: 2>"
    assert without["header"]["frame_id"] == "<string length: <4>>"
    assert message_to_csv(joints) == "0,0,base,a,b,1.0,2.0"
    assert message_to_yaml(joints, flow_style=True) == (
        "{header: {stamp: {sec: 0, nanosec: 0}, frame_id: base}, name: [a, b], "
        "position: [1.0, 2.0], velocity: [], effort: []}\n"
    )


def test_types_are_found_by_their_names() -> None:
    """By the full one, or without the kind."""
    assert get_message("geometry_msgs/msg/PoseStamped") is PoseStamped
    assert get_message("geometry_msgs/PoseStamped") is PoseStamped
    assert get_service("std_srvs/srv/Trigger") is Trigger
    assert get_action("nav2_msgs/action/Spin") is Spin
    assert get_interface("std_srvs/srv/Trigger") is Trigger


@pytest.mark.parametrize(
    ("find", "kind", "said"),
    [
        (lambda: get_message("nope/msg/Nope"), ModuleNotFoundError, "nope/msg/Nope"),
        (lambda: get_message("String"), ValueError, "expected a name such as"),
        (lambda: get_service("std_srvs/msg/Trigger"), ValueError, "std_srvs/srv/Name"),
        (lambda: get_interface("a/b"), ValueError, "expected the full name of a type"),
        (lambda: rosidl_runtime_py.get_interface_path, ImportError, "tfbus topic show"),
    ],
)
def test_what_is_not_there_is_said(
    find: Callable[[], Any], kind: type[Exception], said: str
) -> None:
    """With what is allowed."""
    with pytest.raises(kind, match=said):
        find()
