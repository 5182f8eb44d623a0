"""The turtles: their world, window and interface on the bus, and their guest in the view."""
