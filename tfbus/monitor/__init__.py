"""Measures how transforms come."""
