"""From launch files to a description of their processes."""
