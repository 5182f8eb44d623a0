"""How the rows of a message go to the other side, found once for all messages of one form."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from tfbus.core.packed import EDGE_SIZE, ONE_EDGE, POSE_SIZE, STAMP_SIZE
from tfbus.geometry.columns import Columns, rows_of

# Frames come from the network: routes of at most this many tables of frames are kept.
_MOST_TABLES = 1000


@dataclass(frozen=True, slots=True)
class Route:
    """The names that frames get, and which rows go, None for all. The frames of `contested` rows
    go both ways: each row of theirs is looked at. `children` are those that go, by the names of the
    bus.
    """

    frames: tuple[str, ...]
    rows: Sequence[int] | None
    children: Sequence[str]
    contested: bool = False

    def renamed(self, rows: Columns) -> Columns:
        """The rows that go, with their names there."""
        if self.rows is not None:
            rows = chosen(rows, self.rows)
        return rows if rows.frames is self.frames else rows.with_frames(self.frames)


class Routes:
    """The routes of messages by their frames and edges; `make(rows)` finds a new one. Used by one
    thread at a time, but for `forget`.
    """

    def __init__(self, make: Callable[[Columns], Route]) -> None:
        self._make = make
        self._routes: dict[tuple[tuple[str, ...], bytes], Route] = {}

    def of(self, rows: Columns) -> Route:
        """The route of these rows."""
        table = rows.frames, rows.edges_bytes()
        routes = self._routes
        route = routes.get(table)
        if route is None:
            route = self._make(rows)
            if len(routes) >= _MOST_TABLES:
                routes.clear()
            routes[table] = route
        return route

    def of_one(self, frames: tuple[str, ...]) -> Route | None:
        """The route of one row alone, from the first of two frames to the second, if it is known
        already.
        """
        return self._routes.get((frames, ONE_EDGE))

    def forget(self) -> None:
        """Their conditions have changed."""
        # Another one: a route that is found at this moment is of the past.
        self._routes = {}


def chosen(rows: Columns, which: Sequence[int]) -> Columns:
    """Some of the rows."""
    return Columns.of_bytes(
        rows.frames,
        rows_of(rows.edges, rows.edges_at, EDGE_SIZE, which),
        rows_of(rows.stamps, rows.stamps_at, STAMP_SIZE, which),
        rows_of(rows.poses, rows.poses_at, POSE_SIZE, which),
    )


def route(rows: Columns, name: Callable[[str], str], goes: Callable[[str, str], bool]) -> Route:
    """The route if frames get the `name(frame)`, and rows go for which `goes(parent, child)`."""
    frames = rows.frames
    pairs = rows.pairs()
    kept = [at for at, (parent, child) in enumerate(pairs) if goes(frames[parent], frames[child])]
    names = tuple([name(each) for each in frames])
    return Route(
        frames if names == frames else names,
        None if len(kept) == len(pairs) else kept,
        [frames[pairs[at][1]] for at in kept],
    )
