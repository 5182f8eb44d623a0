"""What `tfbus robot_state` and `tfbus joints` are made of."""
