"""The index of a recording: which transforms its chunks hold, by frame and stamp."""

from typing import TYPE_CHECKING

from tfbus.recording.items import TransformItem

if TYPE_CHECKING:
    from mcap.writer import Writer


class IndexBuilder:
    """Notes, while a file is written, the stamps of each frame in each chunk."""

    def add(self, channel: int, item: TransformItem) -> None:
        """Note a message in the chunk that is being written."""

    def end_chunk(self, offset: int) -> None:
        """The chunk ends; it begins at this place of the file."""

    def write(self, mcap: "Writer") -> None:
        """Write the index into the file, at its end."""
