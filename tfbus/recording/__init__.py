"""Recordings: a bus's traffic in MCAP files; read, written, cut and converted without a bus."""
