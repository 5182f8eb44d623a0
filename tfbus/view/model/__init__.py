"""The state of the page; needs no browser."""
