"""The ROS that is around, by which middleware, and the bridge for its frames."""

from tfbus.doctor.examination import Examination
from tfbus.doctor.finding import Finding, ok
from tfbus.ros.ros_names import HIGHEST_DOMAIN, is_bridge
from tfbus.wire.descriptions import NodeDescription
from tfbus.wording import counted, listed, printable

# The streams that a bridge makes of ROS's publishers are called so, and below.
_BRIDGED = "ros2"
_BRIDGED_1 = "ros1"

# What each bridge publishes on the bus, whatever its name is: the type of its topic.
_BRIDGE_TYPE = "RosBridge"


def check_ros(seen: Examination) -> Finding:
    """The ROS that is there, and how its frames come to tfbus."""
    sentences = [*_rmw_zenoh(seen), *_ros2dds(seen), *_dds(seen), *_sourced(seen), *_ros1(seen)]
    return ok(*(sentences or [_nothing(seen)]))


def _rmw_zenoh(seen: Examination) -> list[str]:
    sentences = []
    for domain, names in sorted(seen.ros.nodes.items()):
        nodes = [name for name in names if not is_bridge(name)]
        if not nodes:
            continue
        options = "--via zenoh"
        if domain != seen.ros.domain:
            options += f" --domain {domain}"
        if seen.ros.at:
            options += f" --ros-connect {seen.ros.at}"
        there = f"rmw_zenoh, domain {domain}, {counted(len(nodes), 'node')}"
        sentences.append(_ros2(seen, there, options))
    return sentences


def _ros2dds(seen: Examination) -> list[str]:
    if not seen.ros.bridges:
        return []
    return [_ros2(seen, "zenoh-bridge-ros2dds", "--via dds", " where its DDS is")]


def _dds(seen: Examination) -> list[str]:
    ros, found = seen.ros, seen.ros.participants
    if ros.domain < 0:
        return [f"ROS_DOMAIN_ID is no domain of ROS 2: 0 to {HIGHEST_DOMAIN} are allowed"]
    if not found:
        if not ros.is_dds_here:
            return []
        return [_maybe_ros2(seen, f"on this host (domain {ros.domain})")]
    vendors = listed(sorted({each.vendor for each in found}))
    there = f"{vendors}, domain {ros.domain}, {counted(len(found), 'participant')}"
    if any(each.is_ros for each in found):
        return [_ros2(seen, there, "--via dds")]
    return [_maybe_ros2(seen, f"on this network ({there})")]


def _sourced(seen: Examination) -> list[str]:
    distro = printable(seen.ros.distro, 40)
    if not distro:
        return []
    if seen.ros.is_ros1:
        return [f"ROS 1 {distro} is sourced here: `tfbus ros1` can use it"]
    return [f"ROS 2 {distro} is sourced here: `tfbus ros2 --via rclpy` can use it"]


def _ros1(seen: Examination) -> list[str]:
    ros = seen.ros
    if ros.master_nodes is None:
        return []
    there = f"ROS 1 is at {printable(ros.master, 100)} ({counted(ros.master_nodes, 'node')})"
    return [f"{there}: {_brings(seen, _BRIDGED_1) or 'its frames come to tfbus by `tfbus ros1`'}"]


def _ros2(seen: Examination, there: str, options: str, where: str = "") -> str:
    how = _brings(seen, _BRIDGED)
    advice = f"its frames come to tfbus by `tfbus ros2 {options}`{where}"
    return f"ROS 2 is on this network ({there}): {how or advice}"


def _maybe_ros2(seen: Examination, where: str) -> str:
    how = _brings(seen, _BRIDGED)
    advice = "if it is ROS 2, its frames come to tfbus by `tfbus ros2 --via dds`"
    return f"DDS is {where}: {how or advice}"


def _brings(seen: Examination, kind: str) -> str:
    """Which nodes are bridges to ROS already; "" for none."""
    bridges = [printable(node.name) for node in seen.nodes if kind in _kinds(node)]
    if not bridges and kind == _BRIDGED:
        in_ros = {name for names in seen.ros.nodes.values() for name in names}
        bridges = [printable(name) for name in sorted(in_ros) if is_bridge(name)]
    return f"{listed(bridges)} bridges it to tfbus" if bridges else ""


def _kinds(node: NodeDescription) -> set[str]:
    """Which ROS a node may be a bridge to; it says which by its name or streams only."""
    names = {node.name.rpartition("/")[2], *[each.partition("/")[0] for each in node.streams]}
    both = {_BRIDGED, _BRIDGED_1}
    return names & both or (both if _BRIDGE_TYPE in node.publishes.values() else set())


def _nothing(seen: Examination) -> str:
    ros = seen.ros
    if not ros.listened_s:
        return "none on Zenoh; DDS could not be heard"
    return f"none on Zenoh, and no DDS in domain {ros.domain} in {ros.listened_s:.0f} s"
