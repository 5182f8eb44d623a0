"""Launch files to a description of what to start."""
