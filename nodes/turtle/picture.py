"""The world as a picture: background, ink, and the turtles seen from above.

Needs pygame but no display. Turtles are drawn large and scaled down, which smooths their edges.
"""

from functools import lru_cache
from math import cos, degrees, radians, sin

import pygame

from . import field
from .turtle_colors import Rgb, TurtleColors, colors_of
from .world import Snapshot, TurtleView

# A sprite is a square of 1.5 m, so that head and legs of the 1 m turtle fit at every angle.
_SPRITE_PX = round(1.5 * field.PIXELS_PER_M)
_OVERSAMPLING = 8
_LABEL_BELOW_PX = 31


class Picture:
    """Draws snapshots on a surface of `field.SIZE_PX` pixels a side."""

    def __init__(self, surface: pygame.Surface) -> None:
        pygame.font.init()
        self.surface = surface
        self._font = pygame.font.Font(None, 19)
        self._shown_ink: object = None
        self._ink = pygame.Surface((0, 0))

    def draw(self, snapshot: Snapshot) -> None:
        """Draw this snapshot over the whole surface."""
        if self._shown_ink is not snapshot.ink:
            self._shown_ink = snapshot.ink
            size = (field.SIZE_PX, field.SIZE_PX)
            ink = pygame.image.frombytes(snapshot.ink.tobytes(), size, "RGBA")
            # Blitting is forty times as fast in SDL's own byte order.
            self._ink = ink.convert(_sdl_order())
        background = snapshot.background
        self.surface.fill((background.r, background.g, background.b))
        self.surface.blit(self._ink, (0, 0))
        for turtle in snapshot.turtles:
            self._draw_turtle(turtle)
        for turtle in snapshot.turtles:
            self._draw_name(turtle)

    def _draw_turtle(self, turtle: TurtleView) -> None:
        image = _sprite(colors_of(turtle.name), round(degrees(turtle.theta)) % 360)
        centre = field.to_pixels(turtle.x, turtle.y)
        self.surface.blit(image, image.get_rect(center=centre))

    def _draw_name(self, turtle: TurtleView) -> None:
        x, y = field.to_pixels(turtle.x, turtle.y)
        below = y + _LABEL_BELOW_PX < field.SIZE_PX - 6
        centre = (x, y + _LABEL_BELOW_PX if below else y - _LABEL_BELOW_PX)
        text = self._font.render(turtle.name, True, (255, 255, 255))
        shadow = self._font.render(turtle.name, True, (0, 0, 0))
        shadow.set_alpha(110)
        place = text.get_rect(center=centre).clamp(self.surface.get_rect().inflate(-4, -4))
        self.surface.blit(shadow, place.move(1, 1))
        self.surface.blit(text, place)


@lru_cache(maxsize=720)
def _sprite(colors: TurtleColors, heading_deg: int) -> pygame.Surface:
    size = _SPRITE_PX * _OVERSAMPLING
    large = pygame.Surface((size, size), pygame.SRCALPHA)
    # Smooth scaling mixes in the colour of transparent pixels: make it the edge's, not black.
    large.fill((*colors.rim, 0))
    _Stencil(large, radians(heading_deg)).turtle(colors)
    return pygame.transform.smoothscale(large, (_SPRITE_PX, _SPRITE_PX))


def _sdl_order() -> pygame.Surface:
    return pygame.Surface((1, 1), pygame.SRCALPHA)


class _Stencil:
    """Shapes in the turtle's own frame: metres, x ahead and y left of its middle."""

    def __init__(self, surface: pygame.Surface, heading: float) -> None:
        self._surface = surface
        self._ahead, self._aside = cos(heading), sin(heading)

    def turtle(self, colors: TurtleColors) -> None:
        """A whole turtle, centred on its shell."""
        for side in (1, -1):
            self.ellipse((0.24, 0.27 * side), (0.20, 0.085), 0.75 * side, colors.rim)
            self.ellipse((0.24, 0.27 * side), (0.18, 0.065), 0.75 * side, colors.skin)
            self.ellipse((-0.25, 0.23 * side), (0.16, 0.08), 2.45 * side, colors.rim)
            self.ellipse((-0.25, 0.23 * side), (0.14, 0.06), 2.45 * side, colors.skin)
        self.polygon([(-0.50, 0.0), (-0.33, 0.07), (-0.33, -0.07)], colors.rim)
        self.ellipse((0.45, 0.0), (0.165, 0.125), 0.0, colors.rim)
        self.ellipse((0.45, 0.0), (0.145, 0.105), 0.0, colors.skin)
        for side in (1, -1):
            self.ellipse((0.50, 0.062 * side), (0.034, 0.034), 0.0, (255, 255, 255))
            self.ellipse((0.512, 0.064 * side), (0.02, 0.02), 0.0, (20, 24, 28))
        self.shell(colors)

    def shell(self, colors: TurtleColors) -> None:
        """The shell: a rim, and plates around a hexagon."""
        self.ellipse((0.0, 0.0), (0.39, 0.32), 0.0, colors.rim)
        self.ellipse((0.0, 0.0), (0.355, 0.285), 0.0, colors.shell)
        corners = [(0.17 * cos(a), 0.15 * sin(a)) for a in (radians(60 * i) for i in range(6))]
        for x, y in corners:
            self.line((x, y), (x * 2.05, y * 1.88), colors.rim)
        self.polygon(corners, colors.rim)
        self.polygon([(0.82 * x, 0.82 * y) for x, y in corners], _lighter(colors.shell))

    def ellipse(
        self, centre: tuple[float, float], radii: tuple[float, float], turn: float, color: Rgb
    ) -> None:
        """An ellipse whose first radius points `turn` rad from straight ahead."""
        ahead, aside = cos(turn), sin(turn)
        points = []
        for angle in (radians(7.5 * step) for step in range(48)):
            x, y = radii[0] * cos(angle), radii[1] * sin(angle)
            points.append((centre[0] + x * ahead - y * aside, centre[1] + x * aside + y * ahead))
        self.polygon(points, color)

    def line(self, start: tuple[float, float], end: tuple[float, float], color: Rgb) -> None:
        """A line as wide as the shell's seams."""
        width = round(0.035 * field.PIXELS_PER_M * _OVERSAMPLING)
        pygame.draw.line(self._surface, color, self._pixel(start), self._pixel(end), width)

    def polygon(self, corners: list[tuple[float, float]], color: Rgb) -> None:
        """A filled polygon."""
        pygame.draw.polygon(self._surface, color, [self._pixel(corner) for corner in corners])

    def _pixel(self, point: tuple[float, float]) -> tuple[float, float]:
        x, y = point
        scale = field.PIXELS_PER_M * _OVERSAMPLING
        middle = self._surface.get_width() / 2
        return (
            middle + (x * self._ahead - y * self._aside) * scale,
            middle - (x * self._aside + y * self._ahead) * scale,
        )


def _lighter(color: Rgb) -> Rgb:
    r, g, b = (part + (255 - part) // 4 for part in color)
    return r, g, b
