"""Transforms as values: one, many; nothing of time or network."""
