"""A buffer of a listener that sends the transforms that it stores on to another bus."""

import math
from collections.abc import Callable, Collection, Iterable

from tfbus.buffer.buffer import Buffer
from tfbus.buffer.insert_many import Permit
from tfbus.geometry.batch import TransformBatch
from tfbus.geometry.columns import Columns, columns_of_batch
from tfbus.geometry.transform import TransformStamped


class PassingBuffer(Buffer):
    """A buffer that passes on the rows that it stores: `on_rows(rows, static, stream)`.

    So another bus gets the rows that a listener accepts: of the right epoch and publisher, and with
    the names that a fleet gives. `leaves_out(stream)` is whether a stream is not wanted.
    """

    def __init__(
        self,
        cache_time_s: float = 10.0,
        *,
        on_rows: Callable[[Columns, bool, str], object],
        leaves_out: Callable[[str], bool] = lambda _: False,
    ) -> None:
        super().__init__(cache_time_s)
        self._on_rows = on_rows
        self._leaves_out = leaves_out

    def set_transforms(
        self,
        batch: TransformBatch | Columns | Iterable[TransformStamped],
        *,
        static: bool = False,
        authority: str = "",
        permit: Permit | None = None,
    ) -> int:
        """As of any buffer."""
        if isinstance(batch, TransformBatch):
            batch = columns_of_batch(batch)
        elif not isinstance(batch, Columns):
            batch = Columns.of_transforms(batch)
        if self._leaves_out(authority):
            return batch.count
        taken = super().set_transforms(batch, static=static, authority=authority, permit=permit)
        if taken == batch.count:
            self._on_rows(batch, static, authority)
        elif taken:
            self._on_rows(self._taken_of(batch), static, authority)
        return taken

    def _taken_of(self, rows: Columns) -> Columns:
        """The rows that are held now, as rows are rarely refused."""
        held = self._held(rows.children())
        return Columns.of_transforms(
            [
                each
                for each in rows.valid()
                if (entry := held.get(each.child_frame_id)) is not None
                and each.frame_id == entry[0]
                and each.stamp_ns >= entry[1]
            ]
        )

    def _held(self, frames: Collection[str]) -> dict[str, tuple[str, float]]:
        """The parent of each of these frames that has one, and the stamp of its oldest sample."""
        held: dict[str, tuple[str, float]] = {}
        with self._store.lock:
            for frame in frames:
                history = self._store.tree.frames.get(frame)
                span = None if history is None else history.stamp_span()
                if history is not None and history.parent is not None and span is not None:
                    held[frame] = history.parent.name, -math.inf if history.static else span[0]
        return held
