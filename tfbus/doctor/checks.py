"""All checks by their stable names, in the order they are printed."""

from collections.abc import Callable

from tfbus.doctor import (
    flow_checks,
    host_checks,
    reader_checks,
    ros_checks,
    secure_checks,
    sim_time_checks,
    tree_checks,
)
from tfbus.doctor.examination import Examination
from tfbus.doctor.finding import Finding

Check = Callable[[Examination], Finding]

CHECKS: dict[str, Check] = {
    "install": host_checks.check_install,
    "kernel": host_checks.check_kernel,
    "zenoh": host_checks.check_zenoh,
    "scouting": host_checks.check_scouting,
    "alone": host_checks.check_alone,
    "routers": host_checks.check_routers,
    "encryption": secure_checks.check_encryption,
    "certificate": secure_checks.check_certificate,
    "rights": secure_checks.check_rights,
    "nodes": tree_checks.check_nodes,
    "node-names": tree_checks.check_node_names,
    "callbacks": tree_checks.check_callbacks,
    "conflicts": tree_checks.check_conflicts,
    "loops": tree_checks.check_loops,
    "orphans": tree_checks.check_orphans,
    "disconnected": tree_checks.check_disconnected,
    "static-dynamic": tree_checks.check_static_dynamic,
    "gone": tree_checks.check_gone,
    "stale": tree_checks.check_stale,
    "silent": tree_checks.check_silent,
    "clock": sim_time_checks.check_clock,
    "clock-skew": flow_checks.check_clock_skew,
    "rates": flow_checks.check_rates,
    "jitter": flow_checks.check_jitter,
    "gaps": flow_checks.check_gaps,
    "order": flow_checks.check_order,
    "stamps": flow_checks.check_stamps,
    "refused": flow_checks.check_refused,
    "messages": flow_checks.check_messages,
    "unread": reader_checks.check_unread,
    "buffers": reader_checks.check_buffers,
    "dropped": reader_checks.check_dropped,
    "ros": ros_checks.check_ros,
}
