"""The tree of frames as a whole: its publishers, its problems, and its pictures."""
