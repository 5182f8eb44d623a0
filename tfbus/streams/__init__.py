"""Transforms out and in: broadcasters send streams, and a listener fills a buffer with them."""
