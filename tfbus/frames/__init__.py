"""The tree of frames as a whole: who publishes what, what is wrong with it, and its pictures."""
