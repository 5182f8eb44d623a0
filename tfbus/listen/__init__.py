"""Transforms in: a listener fills a buffer with the streams of others."""
