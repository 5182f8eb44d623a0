"""Tests of recordings in files."""
