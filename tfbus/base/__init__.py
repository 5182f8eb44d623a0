"""For all packages: errors and their words, frame names, time, threads, signals, log, values."""
