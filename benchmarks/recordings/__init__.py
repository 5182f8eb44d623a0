"""Measures recordings: writing, reading, and what recording and replaying a bus take."""
