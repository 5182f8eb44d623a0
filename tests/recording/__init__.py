"""Recordings in files, without a bus."""
