"""Transforms as values: one, many, or over time; and the compiled arithmetic below them."""
