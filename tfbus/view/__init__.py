"""The page in a browser: frames in three dimensions."""
