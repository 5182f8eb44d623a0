"""The limits of one mesh file."""

# The largest file, and the most triangles in it.
MOST_BYTES = 100_000_000
MOST_TRIANGLES = 2_000_000

# A picture of more pixels is not opened; the sides of others are made at most this long.
MOST_PIXELS = 8192 * 8192
LONGEST_SIDE_PX = 1024

# How long it may take to read one, and with how much memory.
LONGEST_S = 60.0
MOST_MEMORY = 4_000_000_000

# By their suffixes.
KINDS = ("stl", "dae", "obj", "ply", "off", "glb", "gltf")
