"""Records numbered messages without a bus, and prints how many are on the disk: to be killed.

python -m tests.processes.recording_process FILE
"""

import itertools
import logging
import sys
import time
from pathlib import Path

from tests.builders import at, description, payload
from tfbus.bag.keeping import PartsWritten
from tfbus.bag.raw_queue import RawQueue, TransformSource
from tfbus.bag.recorder import Recorder
from tfbus.recording.items import ALL, Item
from tfbus.recording.writer import RecordingWriter
from tfbus.wire.transforms import TransformReader


class Telling(PartsWritten):
    """Prints after each flush how many messages were flushed."""

    messages = 0

    def write(self, item: Item) -> None:
        """Write and count."""
        super().write(item)
        self.messages += 1

    def flush(self) -> None:
        """Flush and print."""
        messages = self.messages
        super().flush()
        print(messages, flush=True)


def main(path: Path) -> None:
    """Record some thousand messages a second until the end."""
    queue = RawQueue(100_000_000)
    source = TransformSource("sim", "", {"sim": description([])}, TransformReader(), static=False)
    Recorder(queue, Telling(path, RecordingWriter), logging.getLogger(), selection=ALL)
    for number in itertools.count():
        queue.put(source, payload([at(number)], seq=number))
        if number % 20 == 0:
            time.sleep(0.005)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
