"""ROS's package turtlesim: what its simulator sends, takes and serves."""
