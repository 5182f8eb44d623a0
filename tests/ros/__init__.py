"""Messages of ROS 2 as bytes."""
