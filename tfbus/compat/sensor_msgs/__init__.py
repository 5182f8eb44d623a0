"""ROS's package sensor_msgs, as far as robots in tf2's examples need it."""
