"""Shared by all command lines: options, argument types, completion."""
