"""Time, threads, signals, log and classes of values of one process."""
