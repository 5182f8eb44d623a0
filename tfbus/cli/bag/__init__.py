"""`tfbus bag`: record a bus, replay it, and cut, convert and repair recordings."""
