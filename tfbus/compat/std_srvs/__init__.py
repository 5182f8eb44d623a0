"""ROS's package std_srvs, as far as turtlesim needs it."""
