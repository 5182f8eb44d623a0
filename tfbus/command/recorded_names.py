"""The names in a recording, for completion."""

from collections.abc import Iterable
from pathlib import Path

from tfbus.command.live_names import LiveNames
from tfbus.errors import TfbusError
from tfbus.recording.items import EventItem
from tfbus.wire.codec import from_map
from tfbus.wire.descriptions import NodeDescription
from tfbus.wire.keys import relative_name


def names_in(paths: Iterable[Path], namespace: str) -> LiveNames:
    """The names in the recording in these files; none if it cannot be read."""
    try:
        from tfbus.recording.reader import RecordingReader
        from tfbus.recording.topics import topics_of

        with RecordingReader(*paths) as reader:
            frames: dict[str, set[str]] = {}
            for part in reader.parts:
                index = part.index
                for channel, edge in zip(index.channel.tolist(), index.edge.tolist(), strict=True):
                    stream = part.stream_channels[channel].stream
                    frames.setdefault(stream.namespace, set()).update(index.edges[edge])
            topics = {name: topic.type for name, topic in topics_of(reader).items()}
            nodes = nodes_in(reader.events)
    except (ImportError, OSError, TfbusError):
        return LiveNames()
    # As the tools do: a recording of one namespace is seen from there.
    seen_from = namespace or (next(iter(frames)) if len(frames) == 1 else "")
    parameters = {
        relative_name(name, namespace): tuple(each.name for each in node.parameters)
        for name, node in nodes.items()
    }
    return LiveNames(
        frames=tuple(sorted(frames.pop(seen_from, ()))),
        robots={robot: tuple(sorted(names)) for robot, names in frames.items()},
        nodes=tuple(sorted(parameters)),
        topics={relative_name(name, namespace).lstrip("/"): text for name, text in topics.items()},
        parameters=parameters,
    )


def nodes_in(events: Iterable[EventItem]) -> dict[str, NodeDescription]:
    """The nodes that these events describe, by their full names; the last description of each."""
    found: dict[str, NodeDescription] = {}
    for event in events:
        if event.kind == "node" and event.facts:
            try:
                node = from_map(NodeDescription, event.facts)
            except (TfbusError, ValueError):
                continue
            found[node.name] = node
    return dict(sorted(found.items()))
