"""All checks by their stable names, in the order they are printed: of a bus and of recordings."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Literal

from tfbus.doctor import flow_checks, host_checks, tree_checks
from tfbus.doctor.examination import Examination, Finding, skipped

# The evidence that a check needs: any moment has the tree of frames; a live bus has this host, and
# what nodes count; a recording has a span of time, with all that came and went in it.
Need = Literal["tree", "bus", "recording"]


@dataclass(frozen=True)
class Check:
    """A check, and the evidence that it needs; it is skipped if an examination has none."""

    find: Callable[[Examination], Finding]
    needs: Need = "tree"

    @property
    def promise(self) -> str:
        """The sentence that holds if it finds nothing."""
        return self.find.__doc__ or ""

    def applies(self, *, to_recording: bool) -> bool:
        """Whether a recording, or a live bus, has the evidence."""
        return self.needs == "tree" or to_recording == (self.needs == "recording")

    def __call__(self, seen: Examination) -> Finding:
        if self.applies(to_recording=seen.span is not None):
            return self.find(seen)
        if self.needs == "recording":
            return skipped("it needs a recording: give --bag FILE")
        return OF_A_BUS


OF_A_BUS = skipped("it needs a live bus: a recording does not have that")


def examined(seen: Examination, names: Iterable[str] = ()) -> dict[str, Finding]:
    """The findings of all checks, or of these, by their names."""
    wanted = set(names) or CHECKS.keys()
    return {name: check(seen) for name, check in CHECKS.items() if name in wanted}


CHECKS: dict[str, Check] = {
    "install": Check(host_checks.check_install, "bus"),
    "kernel": Check(host_checks.check_kernel, "bus"),
    "zenoh": Check(host_checks.check_zenoh, "bus"),
    "scouting": Check(host_checks.check_scouting, "bus"),
    "alone": Check(host_checks.check_alone, "bus"),
    "routers": Check(host_checks.check_routers, "bus"),
    "encryption": Check(host_checks.check_encryption, "bus"),
    "certificate": Check(host_checks.check_certificate, "bus"),
    "rights": Check(host_checks.check_rights, "bus"),
    "complete": Check(flow_checks.check_complete, "recording"),
    "nodes": Check(tree_checks.check_nodes, "bus"),
    "node-names": Check(tree_checks.check_node_names),
    "callbacks": Check(tree_checks.check_callbacks, "bus"),
    "conflicts": Check(tree_checks.check_conflicts),
    "loops": Check(tree_checks.check_loops),
    "orphans": Check(tree_checks.check_orphans),
    "disconnected": Check(tree_checks.check_disconnected),
    "static-dynamic": Check(tree_checks.check_static_dynamic),
    "gone": Check(tree_checks.check_gone),
    "robots": Check(tree_checks.check_robots),
    "restarts": Check(tree_checks.check_restarts, "recording"),
    "stale": Check(tree_checks.check_stale),
    "silent": Check(tree_checks.check_silent),
    "clock": Check(flow_checks.check_clock),
    "clock-skew": Check(flow_checks.check_clock_skew, "bus"),
    "clock-jumps": Check(flow_checks.check_clock_jumps, "recording"),
    "rates": Check(flow_checks.check_rates),
    "jitter": Check(flow_checks.check_jitter),
    "gaps": Check(flow_checks.check_gaps),
    "order": Check(flow_checks.check_order),
    "stamps": Check(flow_checks.check_stamps),
    "refused": Check(flow_checks.check_refused),
    "messages": Check(flow_checks.check_messages, "bus"),
    "unread": Check(tree_checks.check_unread, "bus"),
    "buffers": Check(tree_checks.check_buffers, "bus"),
    "filters": Check(tree_checks.check_filters, "bus"),
    "dropped": Check(tree_checks.check_dropped, "bus"),
    "ros": Check(host_checks.check_ros, "bus"),
}
