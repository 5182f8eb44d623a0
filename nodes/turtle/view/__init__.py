"""The turtles on the page of `tfbus view`."""
