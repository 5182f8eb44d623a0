"""What the page shows; needs no browser."""
