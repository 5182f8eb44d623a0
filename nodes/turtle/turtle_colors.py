"""The colours of turtles, the same in the window and in the browser."""

import re
from typing import NamedTuple
from zlib import crc32

Rgb = tuple[int, int, int]


class TurtleColors(NamedTuple):
    """The colours of one turtle."""

    shell: Rgb
    rim: Rgb
    skin: Rgb


_COLORS = (
    TurtleColors((76, 175, 80), (27, 94, 32), (174, 213, 129)),
    TurtleColors((255, 152, 0), (157, 78, 0), (255, 213, 128)),
    TurtleColors((236, 64, 122), (136, 14, 79), (248, 170, 196)),
    TurtleColors((0, 188, 212), (0, 96, 110), (150, 232, 240)),
    TurtleColors((255, 220, 60), (150, 112, 0), (214, 196, 120)),
    TurtleColors((171, 71, 188), (74, 20, 140), (218, 172, 228)),
    TurtleColors((141, 110, 99), (62, 39, 35), (205, 184, 174)),
    TurtleColors((224, 228, 232), (84, 98, 110), (170, 182, 190)),
)


def colors_of(name: str) -> TurtleColors:
    """The colours of the turtle of this name, the same in every run: turtle1 is green."""
    number = re.search(r"\d+$", name)
    index = int(number[0]) - 1 if number else crc32(name.encode())
    return _COLORS[index % len(_COLORS)]
