"""Zenoh: one session, and what a process declares, sends and asks on it."""
