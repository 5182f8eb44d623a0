"""The turtles' field: turtlesim's size in metres and in pixels."""

SIZE_PX = 500
PIXELS_PER_M = 45.0
# The walls are the centres of the first and the last pixel. This is 499 / 45 in the single
# precision of turtlesim, whose turtle1 therefore starts at 5.544445 and not at 5.544444.
SIZE_M = 11.088889122009277
MIDDLE_M = SIZE_M / 2


def contains(x: float, y: float) -> bool:
    """Whether a point, in metres from the lower left corner, is on the field."""
    return 0.0 <= x <= SIZE_M and 0.0 <= y <= SIZE_M


def to_pixels(x: float, y: float) -> tuple[float, float]:
    """A point of the field in pixels from the upper left corner, y down."""
    return x * PIXELS_PER_M, (SIZE_M - y) * PIXELS_PER_M
