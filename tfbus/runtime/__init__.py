"""Time, threads, signals and log of one process."""
