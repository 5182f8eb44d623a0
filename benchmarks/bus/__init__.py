"""Measures the bus: intake, latency, startup, growth; a section of the page on performance."""
