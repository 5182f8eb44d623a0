"""Messages of ROS 2 as bytes, and their definitions; needs no ROS."""
