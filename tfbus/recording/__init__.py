"""Recordings: the traffic of a bus in MCAP files; read, written, cut and converted without a bus."""
