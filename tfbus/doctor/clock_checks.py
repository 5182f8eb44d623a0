"""Whose time is simulated: a check, and what the other checks have to know of it."""

from tfbus.doctor.examination import Examination, Flow
from tfbus.doctor.finding import Finding, ok
from tfbus.wording import counted

# The type of the topic that tells the time, by whatever name it goes.
_CLOCK = "Clock"


def check_clock(seen: Examination) -> Finding:
    """The doctor goes by the same time as those whom it looks at."""
    tellers = [f"by {node.name}" for node in seen.nodes if _CLOCK in node.publishes.values()]
    if not tellers:
        return ok("no simulated time is told")
    told = f"a simulated time is told here, {' and '.join(tellers)}"
    publishers = [node for node in seen.nodes if node.streams]
    following = _followers(seen)
    follow = f"the stamps of {len(following)} of {counted(len(publishers), 'publisher')} follow it"
    if seen.settings.sim_time or not following:
        return ok(told, follow)
    return Finding(
        "warn",
        (f"{told}; {follow}, and this doctor does not",),
        "give --sim-time to this tool, and to all who look these frames up",
    )


def of_our_time(seen: Examination) -> list[Flow]:
    """The flows whose stamps are by the doctor's own clock, as far as their nodes tell."""
    return list(seen.flows) if seen.settings.sim_time else of_system_time(seen)


def of_system_time(seen: Examination) -> list[Flow]:
    """The flows of those who go by no simulated time, as far as they tell."""
    following = _followers(seen)
    streams = seen.tree.streams
    return [
        flow
        for flow in seen.flows
        if flow.stream not in streams or streams[flow.stream].node not in following
    ]


def _followers(seen: Examination) -> set[str]:
    """The publishers that go by a simulated time which is told here."""
    if not any(_CLOCK in node.publishes.values() for node in seen.nodes):
        return set()
    return {node.name for node in seen.nodes if node.streams and _CLOCK in node.subscribes.values()}
