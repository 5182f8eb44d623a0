"""Transforms out: broadcasters, and the streams that they send in."""
