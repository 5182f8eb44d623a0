"""ROS's package std_msgs, as far as transforms need it."""
