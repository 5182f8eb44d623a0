"""Checks of a bus: checks that each find one kind of trouble."""
