"""The tab of a fleet in the view."""
