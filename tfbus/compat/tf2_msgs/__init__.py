"""ROS's package tf2_msgs, as far as programs with transforms need it."""
