"""The turtle: its world, its window; parts of the simulator."""
