"""The bridge between the bus and ROS: its two directions, and the legs by which it reaches ROS."""
