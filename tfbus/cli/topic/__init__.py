"""`tfbus topic`, a file a verb."""
