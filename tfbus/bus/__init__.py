"""Zenoh: one session, open or closed, what a process declares and asks on it, and the members of
a bus.
"""
