"""Selection of a part of a bus or a recording: topics, streams, frames; a namespace's view."""

import re
from dataclasses import dataclass, replace
from functools import cached_property

from tfbus.errors import InvalidArgumentException
from tfbus.recording.items import EventItem, Item, TopicItem, TransformItem
from tfbus.wire.fleet import Fleet, FrameNames, has_name

# The topics of transforms, as ROS has them.
_DYNAMIC, _STATIC = "tf", "tf_static"


@dataclass(frozen=True)
class Selection:
    """The items to take; everything by default.

    `topics` are names of topics: given, only those. Among them `tf` stands for the dynamic
    transforms of all streams, `tf_static` for their static ones, `robot7/tf` for those of a
    namespace; if none of them is given, there are no transforms unless `streams` or `frames` are
    given too. `streams` are names of streams: given, only those. `frames` are child frames, by
    their own names or those in a fleet, `robot7/base_link`: given, only their transforms. `regex`
    and `exclude` are regular expressions, found anywhere in the name of a topic or stream;
    `exclude_topics` are names as `topics`. Names are full, as a session without a namespace has
    them. The topics `always` are taken in any case.
    """

    topics: tuple[str, ...] = ()
    streams: tuple[str, ...] = ()
    frames: tuple[str, ...] = ()
    regex: str = ""
    exclude: str = ""
    exclude_topics: tuple[str, ...] = ()
    always: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for option in ("regex", "exclude"):
            try:
                re.compile(getattr(self, option))
            except re.error as error:
                raise InvalidArgumentException(
                    f"{option} {getattr(self, option)!r} is no regular expression: {error}"
                ) from error

    # There may be as many as there are streams, and each item is looked for.

    @cached_property
    def _topics(self) -> frozenset[str]:
        return frozenset(self.topics)

    @cached_property
    def _streams(self) -> frozenset[str]:
        return frozenset(self.streams)

    @property
    def is_all(self) -> bool:
        """Whether it takes everything."""
        return self == ALL

    def takes_topic(self, topic: str) -> bool:
        """Whether it takes the messages of a topic."""
        if topic in self.always:
            return True
        if topic in self.exclude_topics:
            return False
        if self.topics:
            return topic in self._topics and self._matches(topic)
        if (self.streams or self.frames) and not self.regex:
            return False
        return self._matches(topic)

    def takes_stream(self, stream: str) -> bool:
        """Whether it takes transforms of a stream, dynamic or static ones."""
        return self.takes_transforms(stream, static=False) or self.takes_transforms(
            stream, static=True
        )

    def takes_transforms(self, stream: str, *, static: bool) -> bool:
        """Whether it takes the dynamic, or the static, transforms of a stream."""
        if _stand_for(self.exclude_topics, stream, static):
            return False
        if any(map(is_of_transforms, self.topics)):
            if not _stand_for(self.topics, stream, static):
                return False
        elif self.topics and not (self.streams or self.frames or self.regex):
            return False
        return (not self.streams or stream in self._streams) and self._matches(stream)

    def takes_frame(self, child: str, namespace: str) -> bool:
        """Whether it takes the transforms of a child frame in a namespace."""
        return not self.frames or any(has_name(child, namespace, name) for name in self.frames)

    def taken_of(self, item: Item) -> Item | None:
        """The item, or the part of it that is taken; None if nothing is."""
        if isinstance(item, EventItem):
            about_stream = item.kind in ("stream", "stream gone")
            return item if not about_stream or self.takes_stream(item.name) else None
        if isinstance(item, TopicItem):
            return item if self.takes_topic(item.topic) else None
        return self._taken_of_transforms(item)

    def _taken_of_transforms(self, item: TransformItem) -> TransformItem | None:
        if not self.takes_transforms(item.stream.name, static=item.static):
            return None
        if not self.frames:
            return item
        namespace, frames = item.stream.namespace, self.frames
        if namespace:
            children = item.rows.children()
            frames = tuple(each for each in children if self.takes_frame(each, namespace))
        rows = item.rows.only(frames)
        return replace(item, rows=rows) if rows.count or item.static else None

    def _matches(self, name: str) -> bool:
        if self.exclude and _is_found(self.exclude, name):
            return False
        return not self.regex or _is_found(self.regex, name)


def lacks_statics(selection: Selection) -> bool:
    """Whether its topics are such that it takes dynamic transforms and no static ones: lookups
    through static frames fail then.
    """
    kinds = {topic.rpartition("/")[2] for topic in selection.topics}
    return _DYNAMIC in kinds and _STATIC not in kinds


def _is_found(regex: str, name: str) -> bool:
    """Whether it is found in a name, which ROS writes with a slash before it."""
    return any(re.search(regex, each) for each in (name, f"/{name}"))


def is_of_transforms(topic: str) -> bool:
    """Whether a topic stands for transforms."""
    return topic.rpartition("/")[2] in (_DYNAMIC, _STATIC)


def _stand_for(topics: tuple[str, ...], stream: str, static: bool) -> bool:
    """Whether one of the topics stands for the dynamic, or static, transforms of a stream."""
    kind = _STATIC if static else _DYNAMIC
    places = [topic.removesuffix(kind) for topic in topics if topic.rpartition("/")[2] == kind]
    return any(map(stream.startswith, places))  # "robot7/", or ""


ALL = Selection()


class Viewpoint:
    """A namespace, "" for none; with a fleet also the namespaces below it. Without a namespace,
    None, all streams are seen, and frames are called as they were sent.
    """

    def __init__(self, namespace: str | None = "", fleet: Fleet | None = None) -> None:
        self._sees_all = namespace is None
        self.namespace = (namespace or "").strip("/")
        self._fleet = fleet
        self._names: dict[str, FrameNames] = {}

    def called(self, stream: str, namespace: str) -> str | None:
        """The name of a stream, by its full name and its namespace; None if it is not seen."""
        if self._sees_all:
            return stream
        if namespace != self.namespace and (self._fleet is None or not self._is_below(namespace)):
            return None
        return stream.removeprefix(f"{self.namespace}/") if self.namespace else stream

    def names(self, namespace: str) -> FrameNames:
        """How the frames of a namespace are called."""
        names = self._names.get(namespace)
        if names is None:
            below = namespace.removeprefix(self.namespace).strip("/")
            fleet = self._fleet or Fleet()
            names = self._names[namespace] = fleet.names(below if self._fleet else "")
        return names

    def _is_below(self, namespace: str) -> bool:
        return not self.namespace or namespace.startswith(f"{self.namespace}/")
