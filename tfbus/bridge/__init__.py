"""The bridge between the bus and ROS: what crosses it, and the legs by which it reaches ROS."""
