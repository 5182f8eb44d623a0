"""The robot my_robot: its nodes and its launch file."""
