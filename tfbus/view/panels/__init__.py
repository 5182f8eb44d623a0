"""The page's controls, one file each."""
