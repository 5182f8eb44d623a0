"""ROS's package sensor_msgs_py: clouds of points as arrays."""

from tfbus.compat.sensor_msgs_py import point_cloud2

__all__ = ["point_cloud2"]
