"""The parts of `tfbus robot_state` and `tfbus joints`."""
