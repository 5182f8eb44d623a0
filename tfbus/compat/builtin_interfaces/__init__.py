"""ROS's package builtin_interfaces: times as messages hold them."""
