"""`tfbus param`."""
