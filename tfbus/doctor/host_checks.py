"""Checks of this host: its packages, and whether it finds other hosts."""

from tfbus.doctor.examination import Examination
from tfbus.doctor.finding import Finding, found, ok, skipped
from tfbus.runtime.installation import SLOWER
from tfbus.wording import counted, listed

_NEEDED = ("eclipse-zenoh", "numpy", "msgpack", "click", "PyYAML")

# The versions of Zenoh that tfbus is tested with.
_ZENOH = "1.10"


def check_install(seen: Examination) -> Finding:
    """tfbus and what it needs are installed."""
    versions = seen.host.versions
    missing = [f"{name} is not installed" for name in _NEEDED if not versions.get(name)]
    fine = f"tfbus {versions.get('tfbus') or '?'} on Python {versions.get('Python', '?')}"
    return found("fail", missing, "pip install tfbus", fine)


def check_kernel(seen: Examination) -> Finding:
    """The buffer is compiled."""
    if seen.host.is_compiled:
        return ok("the buffer is compiled")
    return Finding(
        "warn",
        (seen.host.why_interpreted or f"the buffer is interpreted: {SLOWER}",),
        "reinstall tfbus with a C compiler present, without TFBUS_PURE_PYTHON",
    )


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


def check_alone(seen: Examination) -> Finding:
    """The processes of this host that scout are on the bus."""
    if seen.host.scouted is None:
        return skipped("scouting is off, by the mode or the configuration")
    scouts = seen.host.scouts
    if not scouts:
        return ok("no other program of this host scouts")
    met = {node.pid for node in seen.nodes} & scouts.keys()
    if met:
        return ok(f"{len(met)} of {counted(len(scouts), 'program')} of this host that scout: met")
    names = listed([f"{name} (pid {pid})" for pid, name in sorted(scouts.items())])
    return Finding(
        "warn",
        (f"programs of this host scout, and none of them is on this bus: {names}",),
        "if they should be: give all the same --secure and --config, and restart programs of Zenoh "
        "without tfbus that began before the network was there",
    )


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
