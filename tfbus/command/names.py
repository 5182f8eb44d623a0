"""Names for completion, on the bus (found within 1 s, cached for 5 s) or in a recording."""

import hashlib
import json
import logging
import os
import time
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from tfbus.base.errors import TfbusError
from tfbus.bus.settings import NodeSettings
from tfbus.command.types import LiveNames
from tfbus.wire.codec import from_map
from tfbus.wire.descriptions import NodeDescription
from tfbus.wire.keys import namespace_of, relative_name

if TYPE_CHECKING:
    from tfbus.bus.presence import Described
    from tfbus.bus.session import Session
    from tfbus.recording.items import EventItem

# About as long as typing one line takes.
FRESH_S = 5.0

# A completion must be quick: time to find others, to link, and for answers.
_SCOUTING_S = 0.15
_QUIET_S = 0.1
_SETTLE_S = 0.4
_ANSWER_S = 0.4


def live_names(settings: NodeSettings) -> LiveNames:
    """The names now, or up to 5 s ago; none if the bus cannot be joined."""
    file = _cache_file(settings)
    cached = _cached(file)
    if cached is not None:
        return cached
    try:
        names = look_for_names(settings)
    except TfbusError:
        return LiveNames()
    _cache(file, names)
    return names


def look_for_names(settings: NodeSettings) -> LiveNames:
    """The names now. Raises BusError if the bus cannot be joined."""
    from tfbus.bus.presence import ask_graph
    from tfbus.bus.session import Session  # Zenoh, which cached names do not need

    with Session(settings, logging.Logger("silent"), scouting_s=_SCOUTING_S) as session:
        session.settle(quiet_s=_QUIET_S, timeout_s=_SETTLE_S)
        described = ask_graph(session, timeout_s=_ANSWER_S)
    return _names(described, settings.namespace)


def _names(described: "Described", namespace: str) -> LiveNames:
    graph = described.graph(namespace)
    # A listener reads the streams of its namespace; with a fleet also of the ones below.
    frames: dict[str, set[str]] = {}
    for key, stream in described.streams.items():
        names = {name for parent, child, _ in stream.frames for name in (parent, child)}
        frames.setdefault(namespace_of(key), set()).update(names)
    parameters = {
        relative_name(node.name, namespace): tuple(each.name for each in node.parameters)
        for node in described.nodes
        if not node.name.rpartition("/")[2].startswith("_")
    }
    return LiveNames(
        frames=tuple(sorted(frames.pop("", ()))),
        robots={robot: tuple(sorted(names)) for robot, names in frames.items()},
        nodes=tuple(sorted(parameters)),
        topics={name: ", ".join(topic.types) for name, topic in graph.topics.items()},
        services={
            name: ", ".join(service.types)
            for name, service in graph.services.items()
            if service.servers
        },
        parameters=parameters,
    )


def _cache_file(settings: NodeSettings) -> Path:
    """A file for each place on the bus."""
    files = [each and os.path.abspath(each) for each in (settings.config, settings.secure)]
    place = (settings.namespace, settings.mode, settings.connect, settings.listen, *files)
    name = hashlib.sha256(repr(place).encode()).hexdigest()[:16]
    folder = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(folder) / "tfbus" / f"names-{name}.json"


def _cached(file: Path) -> LiveNames | None:
    try:
        age_s = time.time() - file.stat().st_mtime
        if 0.0 <= age_s < FRESH_S:
            content = json.loads(file.read_text())
            return from_map(LiveNames, content) if isinstance(content, dict) else None
    except (OSError, ValueError, TfbusError):
        pass  # none, or another version's
    return None


def _cache(file: Path, names: LiveNames) -> None:
    """Write the file atomically: several shells may complete at once."""
    with suppress(OSError):
        file.parent.mkdir(parents=True, exist_ok=True)
        part = file.with_suffix(f".{os.getpid()}")
        part.write_text(json.dumps(asdict(names)))
        part.replace(file)


def names_in(paths: Iterable[Path], namespace: str) -> LiveNames:
    """The names in the recording in these files; none if it cannot be read."""
    try:
        from tfbus.recording.reader import RecordingReader, topics_of

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


def nodes_in(events: "Iterable[EventItem]") -> dict[str, NodeDescription]:
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


def namespaces_serving(session: "Session", service: str) -> list[str]:
    """The namespaces below that have this service or action, sorted; asks all nodes, within 1 s."""
    from tfbus.bus.presence import ask_nodes

    services = ask_nodes(session).graph(session.settings.namespace).services.values()
    return sorted(
        each.name.removesuffix(f"/{service}")
        for each in services
        if each.servers and each.name.endswith(f"/{service}")
    )
