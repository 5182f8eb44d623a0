"""How transforms come, measured."""
