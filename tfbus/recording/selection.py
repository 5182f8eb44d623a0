"""Which part of a bus or of a recording is meant: topics, streams, frames."""

import re
from dataclasses import dataclass, replace

from tfbus.errors import InvalidArgumentException
from tfbus.recording.items import EventItem, Item, TopicItem, TransformItem


@dataclass(frozen=True)
class Selection:
    """What to take; everything by default.

    `topics` are names of topics: given, only those, and no transforms unless `streams` or `frames`
    are given too; `tf` and `tf_static` among them stand for the transforms of all streams,
    `robot7/tf` for those of a namespace. `streams` are names of streams: given, only those.
    `frames` are child frames: given, only their transforms. `regex` and `exclude` are regular
    expressions, found anywhere in the name of a topic or stream. Names are full, as a session
    without a namespace has them. The topics `always` are taken in any case.
    """

    topics: tuple[str, ...] = ()
    streams: tuple[str, ...] = ()
    frames: tuple[str, ...] = ()
    regex: str = ""
    exclude: str = ""
    always: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for option in ("regex", "exclude"):
            try:
                re.compile(getattr(self, option))
            except re.error as error:
                raise InvalidArgumentException(
                    f"{option} {getattr(self, option)!r} is no regular expression: {error}"
                ) from error

    @property
    def is_all(self) -> bool:
        """Whether it takes everything."""
        return self == ALL

    def takes_topic(self, topic: str) -> bool:
        """Whether it takes the messages of a topic."""
        if topic in self.always:
            return True
        if self.topics:
            return topic in self.topics and self._matches(topic)
        if (self.streams or self.frames) and not self.regex:
            return False
        return self._matches(topic)

    def takes_stream(self, stream: str) -> bool:
        """Whether it takes transforms of a stream."""
        if self.streams:
            return stream in self.streams and self._matches(stream)
        if self.topics and not self.frames and not self.regex:
            named = any(is_of_transforms(topic, stream) for topic in self.topics)
            return named and self._matches(stream)
        return self._matches(stream)

    def taken_of(self, item: Item) -> Item | None:
        """The item, or the part of it that is taken; None where nothing is."""
        if isinstance(item, EventItem):
            about_stream = item.kind in ("stream", "stream gone")
            return item if not about_stream or self.takes_stream(item.name) else None
        if isinstance(item, TopicItem):
            return item if self.takes_topic(item.topic) else None
        return self._taken_of_transforms(item)

    def _taken_of_transforms(self, item: TransformItem) -> TransformItem | None:
        if not self.takes_stream(item.stream.name):
            return None
        if not self.frames:
            return item
        rows = item.rows.only(self.frames)
        return replace(item, rows=rows) if rows.count or item.static else None

    def _matches(self, name: str) -> bool:
        if self.exclude and re.search(self.exclude, name):
            return False
        return not self.regex or re.search(self.regex, name) is not None


def is_of_transforms(topic: str, stream: str = "") -> bool:
    """Whether a topic stands for transforms, those of this stream among them."""
    namespace, _, last = topic.rpartition("/")
    if last not in ("tf", "tf_static"):
        return False
    return not stream or not namespace or stream.startswith(f"{namespace}/")


ALL = Selection()
