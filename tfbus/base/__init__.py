"""For all packages: errors and their words, names of frames, time, threads, signals, log, values."""
