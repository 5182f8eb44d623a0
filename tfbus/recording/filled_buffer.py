"""Fills a buffer with items as a listener would."""

from tfbus.buffer.buffer import Buffer
from tfbus.recording.items import EventItem, Item, RecordedStream, TransformItem
from tfbus.recording.pauses import pauses_of


class FilledBuffer:
    """A buffer that takes items: a larger epoch of a stream voids its earlier samples, a static set
    replaces the one before, frames that a description leaves out are removed, and those of a
    publisher that is gone are marked. A pause of the recorder interrupts the samples.

    `start_ns` is the beginning of the recording.
    """

    def __init__(self, buffer: Buffer, start_ns: int) -> None:
        self.buffer = buffer
        self._start_ns = start_ns
        self._paused: EventItem | None = None
        self._epochs: dict[str, int] = {}
        self._gone: set[str] = set()
        # The children of the last static set of a stream, and its epoch.
        self._static: dict[str, tuple[int, frozenset[str]]] = {}
        # What the last description of a stream lists, and its epoch.
        self._listed: dict[str, tuple[int, frozenset[str]]] = {}

    def take(self, item: Item) -> None:
        """Take an item; items come in order of their log times."""
        if isinstance(item, TransformItem):
            self._take_transforms(item)
        elif isinstance(item, EventItem) and item.kind == "stream gone":
            self._gone.add(item.name)
            self.buffer.mark_gone(self.buffer.sent_by(item.name), True, item.name)
        elif isinstance(item, EventItem) and item.kind == "stream":
            self._take_description(item)
        elif isinstance(item, EventItem) and item.kind == "paused":
            self._paused = self._paused or item
        elif isinstance(item, EventItem) and item.kind == "resumed" and self._paused is not None:
            for pause in pauses_of((self._paused, item), item.log_ns):
                self.buffer.interrupt(pause.said(self._start_ns))
            self._paused = None

    def _take_transforms(self, item: TransformItem) -> None:
        if not (self._counts_as_set(item) if item.static else self._counts(item.stream)):
            return
        self.buffer.set_transforms(item.rows, static=item.static, authority=item.stream.name)

    def _counts_as_set(self, item: TransformItem) -> bool:
        """Whether a static set is the last one; what it leaves out is removed.

        A stream whose clock went back may keep the set of a former epoch.
        """
        name, epoch_ns = item.stream.name, item.stream.epoch_ns
        last_ns, children = self._static.get(name, (epoch_ns, frozenset()))
        if epoch_ns < last_ns and name not in self._gone:
            return False
        if epoch_ns > self._epochs.get(name, -1):
            self._counts(item.stream)
        now = item.rows.children()
        if left_out := children - now:
            self.buffer.remove_sent(left_out, name)
        self._static[name] = epoch_ns, now
        return True

    def _counts(self, stream: RecordedStream) -> bool:
        """Whether dynamic transforms of this epoch count; a new one voids what was before."""
        present = self._epochs.get(stream.name)
        if present == stream.epoch_ns:
            return True
        is_restart = stream.name in self._gone
        if present is not None and stream.epoch_ns < present and not is_restart:
            return False
        if present is not None:
            self.buffer.forget(stream.name)
        self._epochs[stream.name] = stream.epoch_ns
        self._gone.discard(stream.name)
        return True

    def _take_description(self, item: EventItem) -> None:
        epoch = item.facts.get("epoch")
        frames = item.facts.get("frames")
        if not isinstance(epoch, int) or not isinstance(frames, (list, tuple)):
            return
        listed = frozenset(
            row[1]
            for row in frames
            if isinstance(row, (list, tuple)) and len(row) == 3 and isinstance(row[1], str)
        )
        before, former = self._listed.get(item.name, (epoch, frozenset()))
        if before == epoch and (removed := former - listed):
            self.buffer.remove_sent(removed, item.name)
        self._listed[item.name] = epoch, listed
        if item.name in self._gone:
            self.buffer.mark_gone(self.buffer.sent_by(item.name), False, item.name)
