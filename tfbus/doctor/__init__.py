"""What is wrong with a bus: checks that each find one kind of trouble."""
