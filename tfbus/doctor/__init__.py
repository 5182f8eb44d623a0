"""Checks of a bus: checks that each find one kind of trouble."""

# Each lists its own checks, in this order.
from tfbus.doctor import host_checks, tree_checks, flow_checks  # noqa: F401, I001
