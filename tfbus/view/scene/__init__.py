"""The shapes in three dimensions."""
