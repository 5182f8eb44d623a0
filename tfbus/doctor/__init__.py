"""What is wrong with a bus and why: checks, each of which finds one kind of trouble."""
