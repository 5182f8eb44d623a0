"""Transforms out."""
