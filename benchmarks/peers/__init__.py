"""One small file per peer: how it is filled, and how it is asked."""
