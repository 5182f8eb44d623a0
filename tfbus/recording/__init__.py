"""Recordings: what was on a bus, in MCAP files; read, written, cut and converted without a bus."""
