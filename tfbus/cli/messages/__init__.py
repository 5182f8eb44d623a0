"""Messages on the command line: typed in, printed, filtered."""
