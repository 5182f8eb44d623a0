"""The supplied processes: one file, one process; installed as `tfbus.nodes`."""
