"""Messages that the page draws beside the frames, such as scans and images; without the browser."""
