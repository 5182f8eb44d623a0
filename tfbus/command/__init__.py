"""What every command line shares: options, argument types, completion."""
