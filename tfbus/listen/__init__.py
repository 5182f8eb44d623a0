"""Transforms in."""
