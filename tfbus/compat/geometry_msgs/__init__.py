"""ROS's package geometry_msgs, as far as tf2 and turtlesim need it."""
