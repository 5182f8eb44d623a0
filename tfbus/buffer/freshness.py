"""How fresh a lookup wants its data: no older than so long, or of publishers that live."""

from collections.abc import Iterable
from dataclasses import dataclass

from tfbus.buffer.tree import Tree
from tfbus.core.kernel import History
from tfbus.errors import InvalidArgumentException, StaleException


@dataclass(frozen=True)
class Freshness:
    """What every edge on the path of a lookup has to be.

    `max_age_s` is how old its newest sample may be, by the buffer's clock (None: any age); a
    static edge has no age. `living` is whether its publisher must be there, a static one's too.
    """

    max_age_s: float | None = None
    living: bool = False

    def __post_init__(self) -> None:
        if self.max_age_s is not None and not self.max_age_s >= 0.0:
            raise InvalidArgumentException(
                f"max_age_s is {self.max_age_s!r}; it is a number of seconds, 0 or more"
            )

    def why_stale(
        self, tree: Tree, pairs: Iterable[tuple[str, str]], now_ns: int
    ) -> StaleException | None:
        """The error where a path between two of the frames is not so; None where all are.

        A publisher that is gone comes before an old sample: it is why the sample is old.
        """
        paths = [tree.path(target_frame, source_frame) for target_frame, source_frame in pairs]
        edges = [edge for path in paths if path is not None for edge in path.edges()]
        gone = next((edge for edge in edges if edge.gone), None)
        if self.living and gone is not None:
            return _stale(gone, _age_s(gone, now_ns), "its publisher is gone; start it again")
        if self.max_age_s is None:
            return None
        aged = [(age_s, edge) for edge in edges if (age_s := _age_s(edge, now_ns)) is not None]
        age_s, oldest = max(aged, key=lambda pair: pair[0], default=(0.0, None))
        if oldest is None or age_s <= self.max_age_s:
            return None
        allowed = f"max_age_s allows {self.max_age_s:g} s"
        if oldest.gone:
            return _stale(oldest, age_s, f"{allowed}, and its publisher is gone; start it again")
        return _stale(oldest, age_s, f"{allowed}; wait for the next (timeout_s), or allow more")


def _age_s(edge: History, now_ns: int) -> float | None:
    span = None if edge.static else edge.stamp_span()
    return None if span is None else (now_ns - span[1]) / 1e9


def _stale(edge: History, age_s: float | None, why: str) -> StaleException:
    parent = edge.parent.name if edge.parent is not None else ""
    sent = f", sent by {edge.authority!r}," if edge.authority else ""
    what = "static" if age_s is None else f"{age_s:.3f} s old"
    return StaleException(
        f"{parent!r} -> {edge.name!r}{sent} is {what}: {why}",
        frame_id=parent,
        child_frame_id=edge.name,
        authority=edge.authority,
        age_s=age_s,
        gone=edge.gone,
    )
