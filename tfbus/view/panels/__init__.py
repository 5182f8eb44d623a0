"""The page's controls, a file each."""
