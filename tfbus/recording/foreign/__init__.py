"""Files of ROS and Foxglove, message by message: rosbag1, rosbag2, and MCAP of other writers."""
