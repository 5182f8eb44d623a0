"""Which publishers use simulated time: a check, and what other checks need of it."""

from tfbus.doctor.examination import Examination
from tfbus.doctor.finding import Finding, ok
from tfbus.monitor.meter import EdgeFlow
from tfbus.wording import counted

# The type of the clock's topic, whatever its name.
_CLOCK = "Clock"


def check_clock(seen: Examination) -> Finding:
    """The doctor uses the same time as the publishers."""
    clocks = [node.name for node in seen.nodes if _CLOCK in node.publishes.values()]
    if not clocks:
        return ok("no simulated time is published")
    published = f"{' and '.join(clocks)} publish{'es' * (len(clocks) == 1)} a simulated time"
    publishers = [node for node in seen.nodes if node.streams]
    following = _followers(seen)
    follow = f"the stamps of {len(following)} of {counted(len(publishers), 'publisher')} follow it"
    if seen.settings.sim_time or not following:
        return ok(published, follow)
    return Finding(
        "warn",
        (f"{published}; {follow}, and this doctor does not",),
        "give --sim-time to this tool, and to all nodes that look up these frames",
    )


def of_our_time(seen: Examination) -> list[EdgeFlow]:
    """The flows whose stamps are by the doctor's own clock, as far as their nodes say."""
    return list(seen.flows) if seen.settings.sim_time else of_system_time(seen)


def of_system_time(seen: Examination) -> list[EdgeFlow]:
    """The flows of publishers without simulated time, as far as their nodes say."""
    following = _followers(seen)
    streams = seen.tree.streams
    return [
        flow
        for flow in seen.flows
        if flow.stream not in streams or streams[flow.stream].node not in following
    ]


def _followers(seen: Examination) -> set[str]:
    """The publishers that use a simulated time."""
    if not any(_CLOCK in node.publishes.values() for node in seen.nodes):
        return set()
    return {node.name for node in seen.nodes if node.streams and _CLOCK in node.subscribes.values()}
