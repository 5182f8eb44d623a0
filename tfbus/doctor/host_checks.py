"""Checks of this host and its surroundings: packages, network, keys, ROS."""

from collections.abc import Iterable, Mapping
from datetime import UTC, datetime, timedelta

from tfbus.base.installation import SLOWER, compile_command
from tfbus.base.wording import counted, listed, printable
from tfbus.doctor.examination import Examination, Finding, check, found, ok, skipped
from tfbus.ros.rmw import HIGHEST_DOMAIN, is_bridge
from tfbus.wire.descriptions import NodeDescription

_NEEDED = ("eclipse-zenoh", "numpy", "msgpack", "click", "PyYAML")

# The versions of Zenoh that tfbus is tested with.
_ZENOH = "1.10"


@check("install", needs="bus")
def check_install(seen: Examination) -> Finding:
    """tfbus and what it needs are installed."""
    versions = seen.host.versions
    missing = [f"{name} is not installed" for name in _NEEDED if not versions.get(name)]
    fine = f"tfbus {versions.get('tfbus') or '?'} on Python {versions.get('Python', '?')}"
    return found("fail", missing, "pip install tfbus", fine)


@check("kernel", needs="bus")
def check_kernel(seen: Examination) -> Finding:
    """The buffer is compiled."""
    if seen.host.is_compiled:
        return ok("the buffer is compiled")
    return Finding(
        "warn",
        (seen.host.why_interpreted or f"the buffer is interpreted: {SLOWER}",),
        f"with a C compiler, and without TFBUS_PURE_PYTHON: {compile_command()}",
    )


@check("zenoh", needs="bus")
def check_zenoh(seen: Examination) -> Finding:
    """tfbus is tested with this version of Zenoh."""
    version = seen.host.versions.get("eclipse-zenoh", "")
    if version.startswith(f"{_ZENOH}."):
        return ok(f"eclipse-zenoh {version}")
    return Finding(
        "warn",
        (f"eclipse-zenoh {version or 'is not installed'}; tfbus is tested with {_ZENOH}",),
        f"pip install 'eclipse-zenoh~={_ZENOH}.0'",
    )


@check("scouting", needs="bus")
def check_scouting(seen: Examination) -> Finding:
    """Processes find each other by multicast."""
    if seen.host.scouted is None:
        return skipped("scouting is off, by the mode or the configuration")
    carriers = [
        each.name
        for each in seen.host.interfaces
        if each.is_up and each.has_carrier and each.has_multicast
    ]
    if seen.host.scouted:
        where = f"on {', '.join(carriers)}" if carriers else "on this host alone: it has no network"
        return ok(f"a session of this host was found by multicast {where}")
    evidence = ["a session of this host was not found by multicast"]
    if not carriers:
        evidence.append("no interface is up and carries multicast")
        remedy = "bring up a network (ip link set eth0 up multicast on), or give --connect ENDPOINT"
    else:
        evidence.append(f"{', '.join(carriers)} should carry it: a firewall may block it")
        remedy = "open UDP port 7446 to 224.0.0.224 in the firewall, or give --connect ENDPOINT"
    return Finding("fail", tuple(evidence), remedy)


@check("alone", needs="bus")
def check_alone(seen: Examination) -> Finding:
    """The processes of this host that scout run, and are on the bus."""
    if seen.host.scouted is None:
        return skipped("scouting is off, by the mode or the configuration")
    scouts = seen.host.scouts
    if not scouts:
        return ok("no other program of this host scouts")
    if stopped := seen.host.stopped & scouts.keys():
        return Finding(
            "warn",
            (f"programs of this host scout, and are stopped: {_programs(scouts, stopped)}",),
            "no link opens to a program that does not run: let it go on (fg, kill -CONT, the "
            "debugger), or end it",
        )
    met = {node.pid for node in seen.moment.nodes} & scouts.keys()
    if met:
        others = _programs(scouts, scouts.keys() - met)
        return ok(
            f"scouting programs of this host with a node on this bus: {len(met)} of {len(scouts)}",
            *([f"without one, as a launch: {others}"] if others else []),
        )
    names = _programs(scouts, scouts)
    return Finding(
        "warn",
        (f"programs of this host scout, and none of them is on this bus: {names}",),
        "if they should be: give all the same --secure and --config, and restart programs of Zenoh "
        "without tfbus that began before the network was there",
    )


def _programs(scouts: Mapping[int, str], pids: Iterable[int]) -> str:
    return listed([f"{scouts[pid]} (pid {pid})" for pid in sorted(pids)])


@check("routers", needs="bus")
def check_routers(seen: Examination) -> Finding:
    """The endpoints of --connect answer."""
    endpoints = seen.settings.connect
    evidence = [f"{endpoint}: {why}" for endpoint, why in seen.host.unreachable.items()]
    if endpoints:
        return found(
            "fail",
            evidence,
            "start the router there (tfbus router), and open its port in the firewall",
            f"{', '.join(endpoints)} answers",
        )
    if seen.host.routers:
        return ok(f"connected to {counted(seen.host.routers, 'router')} that scouting found")
    return skipped("no --connect was given, and scouting found no router")


_SOON = timedelta(days=30)

_OPEN = "it is an open bus"


@check("encryption", needs="bus")
def check_encryption(seen: Examination) -> Finding:
    """The bus is closed, or no other machine is on it."""
    closed = seen.settings.closed
    if closed is not None:
        identity = closed.identity
        said = f"encrypted; this is identity {identity.name!r}, {identity.role}"
        return ok(said, *filter(None, (seen.host.without_datagrams,)))
    beyond = list(seen.host.listens_beyond)
    if not beyond:
        return ok("open, to this machine only")
    others = sorted({node.host for node in seen.moment.nodes} - {seen.host.name})
    if not others and not seen.host.routers:
        return ok("open; no other machine is on it now; --secure closes it")
    who = f"{listed(others)} {'is' if len(others) == 1 else 'are'} on it" if others else "routed"
    evidence = [
        f"an open bus; {who}, and any process that reaches {listed(beyond)} can read everything, "
        "send any frame, call any service and set any parameter"
    ]
    return found(
        "warn",
        evidence,
        "on a network that others use: tfbus keys init, and --secure (docs/guide/security.md)",
    )


@check("certificate", needs="bus")
def check_certificate(seen: Examination) -> Finding:
    """The certificate of this identity is valid for a while."""
    closed = seen.settings.closed
    if closed is None:
        return skipped(_OPEN)
    left = closed.ends - datetime.now(UTC)
    name = closed.identity.name
    evidence = [f"that of {name!r} expires on {closed.ends:%Y-%m-%d}, in {left.days} days"]
    return found(
        "warn",
        evidence if left < _SOON else [],
        f"tfbus keys renew {name}, and export it to this machine",
        f"valid until {closed.ends:%Y-%m-%d}",
    )


@check("rights", needs="bus")
def check_rights(seen: Examination) -> Finding:
    """All nodes enforce the same rights, and none is wider than its role needs."""
    closed = seen.settings.closed
    if closed is None:
        return skipped(_OPEN)
    others = [
        each.name for each in seen.moment.nodes if each.rights and each.rights != closed.digest
    ]
    publishers = [
        each
        for each in closed.rights.identities.values()
        if each.role == "publisher" and not each.revoked
    ]
    # A robot that is alone in its namespace takes no other's streams.
    wide = [
        f"{identity.name} may be any node, and so publish any stream"
        for identity in publishers
        if {"*", "**", "**/*"}.intersection(identity.nodes or ())
        and any(each != identity and identity.is_within(each.namespace) for each in publishers)
    ]
    if others:
        return Finding(
            "fail",
            (f"{counted(len(others), 'node')} with other rights than these: {listed(others)}",),
            "copy the last rights.yaml to every machine (tfbus keys export), and restart its nodes",
        )
    return found(
        "warn",
        wide,
        "name its nodes in rights.yaml",
        f"{counted(len(closed.rights.identities), 'name')} in them",
    )


# The streams that a bridge makes of ROS's publishers are called so, and below.
_BRIDGED = "ros2"
_BRIDGED_1 = "ros1"

# The type of each bridge's own topic on the bus, whatever the bridge's name is.
_BRIDGE_TYPE = "RosBridge"


@check("ros", needs="bus")
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
    """A clause on the nodes that are bridges to ROS already; "" for none."""
    bridges = [printable(node.name) for node in seen.moment.nodes if kind in _kinds(node)]
    if not bridges and kind == _BRIDGED:
        in_ros = {name for names in seen.ros.nodes.values() for name in names}
        bridges = [printable(name) for name in sorted(in_ros) if is_bridge(name)]
    return f"{listed(bridges)} bridges it to tfbus" if bridges else ""


def _kinds(node: NodeDescription) -> set[str]:
    """The kinds of ROS that a node may be a bridge to, told only by its name or streams."""
    names = {node.name.rpartition("/")[2], *[each.partition("/")[0] for each in node.streams]}
    both = {_BRIDGED, _BRIDGED_1}
    return names & both or (both if _BRIDGE_TYPE in node.publishes.values() else set())


def _nothing(seen: Examination) -> str:
    ros = seen.ros
    if not ros.listened_s:
        return "none on Zenoh; DDS could not be heard"
    return f"none on Zenoh, and no DDS in domain {ros.domain} in {ros.listened_s:.0f} s"
