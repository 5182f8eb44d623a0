"""The place at which each frame of a tree is drawn, in inches from the top left."""

from dataclasses import dataclass

from tfbus.frames.snapshot import FrameTree


@dataclass(frozen=True)
class Size:
    """How wide a frame's label is: its name, and its facts in a smaller type."""

    name: float
    facts: float


@dataclass(frozen=True)
class Place:
    """A frame's name, the facts about it, and the line from its parent that ends at the name.

    `x` and `y` are the left end of the name, `facts_x` and `facts_y` of the facts; `line` has the
    corners of the line, none for a root.
    """

    x: float
    y: float
    facts_x: float
    facts_y: float
    line: tuple[tuple[float, float], ...] = ()


_GAP, _BEND, _ARROW = 0.45, 0.31, 0.14
_TIDY_ROW, _FACTS_BELOW = 0.46, 0.15
_OUTLINE_ROW, _INDENT = 0.26, 0.4


def tidy(tree: FrameTree, sizes: dict[str, Size]) -> dict[str, Place]:
    """A column for each depth, a row for each leaf, a parent midway between its children."""
    depth: dict[str, int] = {}
    row: dict[str, float] = {}
    leaves = 0
    for root in tree.roots:
        order = list(tree.walk(root.name))
        for level, frame in order:
            depth[frame.name] = level
            if not tree.children(frame.name):
                row[frame.name] = leaves
                leaves += 1
        for _, frame in reversed(order):
            if children := tree.children(frame.name):
                row[frame.name] = (row[children[0]] + row[children[-1]]) / 2
    lefts = _columns(depth, sizes)
    places = {}
    for name, level in depth.items():
        x, y = lefts[level], row[name] * _TIDY_ROW
        parent = tree.frames[name].parent
        line: tuple[tuple[float, float], ...] = ()
        if parent in depth:
            from_x = lefts[level - 1] + sizes[parent].name + 0.08
            from_y, bend = row[parent] * _TIDY_ROW, x - _BEND
            line = ((from_x, from_y), (bend, from_y), (bend, y), (x - _ARROW, y))
        places[name] = Place(x, y, x, y + _FACTS_BELOW, line)
    return places


def outline(tree: FrameTree, sizes: dict[str, Size]) -> dict[str, Place]:
    """A row for each frame, its children below it and further right: for large trees."""
    places: dict[str, Place] = {}
    for root in tree.roots:
        for depth, frame in tree.walk(root.name):
            x, y = depth * _INDENT, len(places) * _OUTLINE_ROW
            line: tuple[tuple[float, float], ...] = ()
            if frame.parent in places:
                trunk = x - _INDENT + 0.1
                from_y = places[frame.parent].y + 0.08
                line = ((trunk, from_y), (trunk, y), (x - _ARROW / 2, y))
            places[frame.name] = Place(x, y, x + sizes[frame.name].name + 0.15, y, line)
    return places


def extent(places: dict[str, Place], sizes: dict[str, Size]) -> tuple[float, float]:
    """How wide and how high the drawing is."""
    rights = [
        max(place.x + sizes[name].name, place.facts_x + sizes[name].facts)
        for name, place in places.items()
    ]
    bottoms = [place.facts_y for place in places.values()]
    return max(rights, default=0.0), max(bottoms, default=0.0)


def _columns(depth: dict[str, int], sizes: dict[str, Size]) -> list[float]:
    """The beginning of each column."""
    widths = [0.0] * (1 + max(depth.values(), default=0))
    for name, level in depth.items():
        widths[level] = max(widths[level], sizes[name].name, sizes[name].facts)
    lefts = [0.0]
    for width in widths:
        lefts.append(lefts[-1] + width + _GAP)
    return lefts
