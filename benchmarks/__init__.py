"""tfbus beside its peers, on the same data: `make bench`, or `python -m benchmarks`."""
