"""Numbers: pose arithmetic, the history of one edge, paths; compiled where possible."""
