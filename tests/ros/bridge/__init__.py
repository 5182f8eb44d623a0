"""Tests of the bridge to ROS."""
