"""Which publishers use simulated time: a check, and what other checks need of it."""

from tfbus.doctor.examination import Examination
from tfbus.doctor.finding import Finding, ok
from tfbus.frames.simulated import simulated_time
from tfbus.monitor.flow import EdgeFlow


def check_clock(seen: Examination) -> Finding:
    """The doctor uses the same time as the publishers."""
    time = simulated_time(seen.nodes)
    if not time.clocks:
        return ok("no simulated time is published")
    if seen.settings.sim_time or not time.followers:
        return ok(time.published, time.followed)
    return Finding(
        "warn",
        (f"{time.published}; {time.followed}, and this doctor does not",),
        "give --sim-time to this tool, and to all nodes that look up these frames",
    )


def of_our_time(seen: Examination) -> list[EdgeFlow]:
    """The flows whose stamps are by the doctor's own clock, as far as their nodes say."""
    return list(seen.flows) if seen.settings.sim_time else of_system_time(seen)


def of_system_time(seen: Examination) -> list[EdgeFlow]:
    """The flows of publishers without simulated time, as far as their nodes say."""
    following = simulated_time(seen.nodes).followers
    streams = seen.tree.streams
    return [
        flow
        for flow in seen.flows
        if flow.stream not in streams or streams[flow.stream].node not in following
    ]
