"""Identities of a closed bus, and the rights of each."""
