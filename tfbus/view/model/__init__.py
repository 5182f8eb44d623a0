"""What the page shows, known without a browser."""
