"""The protocol between processes, in a simulated network."""
