"""The nodes and streams on the bus, how each describes itself, and why none is there."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace

from tfbus.base import scheduler
from tfbus.base.errors import BusError, DecodeError
from tfbus.base.wording import did_you_mean, natural_order, printable
from tfbus.bus.callbacks import OnToken
from tfbus.bus.graph import Graph, graph_of
from tfbus.bus.links import why_unreachable
from tfbus.bus.neighbours import scout
from tfbus.bus.network_session import Declaration
from tfbus.bus.query import Answer
from tfbus.bus.retained import ask_retained
from tfbus.bus.session import Session
from tfbus.bus.zenoh_config import has_scouting
from tfbus.wire.codec import decode_message
from tfbus.wire.descriptions import NodeDescription, StreamDescription, read_description
from tfbus.wire.keys import (
    ALL_NODES_EVERYWHERE,
    ALL_STREAMS_EVERYWHERE,
    full_name,
    namespace_of,
    node_key,
    relative_name,
    stream_of,
)

# A process that is busy, or on a busy host, may take that long to answer; all others at once.
PATIENCE_S = 5.0
# A link may be open before its far end has said on it who is there.
_SAID_WITHIN_S = 1.0
_AGAIN_AFTER_S = 0.1


def list_nodes(session: Session) -> list[str]:
    """The full names of the nodes that are alive, sorted: `/sim`, `/robot7/sim`."""
    namespace = session.settings.namespace
    deadline_s = scheduler.monotonic() + _SAID_WITHIN_S
    while not (living := session.living(ALL_NODES_EVERYWHERE)):
        if not session.linked() or scheduler.monotonic() >= deadline_s:
            break
        scheduler.sleep(_AGAIN_AFTER_S)
    names = (printable(full_name(key, namespace)) for key in living)
    return sorted(names, key=natural_order)


@dataclass(frozen=True)
class Described:
    """The nodes and streams on the bus, as they describe themselves.

    `streams` are by their keys; of several at one key the one counts whose session it names.
    `silent_nodes`, by full name, and `silent_streams`, by key, are alive and
    did not answer in time. `unreadable` are the errors of descriptions that cannot be read.
    """

    nodes: tuple[NodeDescription, ...] = ()
    silent_nodes: tuple[str, ...] = ()
    streams: Mapping[str, StreamDescription] = field(default_factory=dict)
    silent_streams: tuple[str, ...] = ()
    unreadable: tuple[DecodeError, ...] = ()

    def graph(self, namespace: str) -> Graph:
        """The topics and services, as seen from the namespace."""
        return graph_of(self.nodes, self.streams, namespace)


def ask_graph(session: Session, *, timeout_s: float = 1.0) -> Described:
    """All nodes and streams, and the silent ones; two queries take `timeout_s` each at most."""
    alive = session.living(ALL_NODES_EVERYWHERE)
    nodes = ask_nodes(session, alive=alive, timeout_s=timeout_s)
    streams = ask_streams(session, timeout_s=timeout_s)
    return replace(
        nodes,
        streams=streams.streams,
        silent_streams=streams.silent_streams,
        unreadable=nodes.unreadable + streams.unreadable,
    )


def ask_nodes(
    session: Session, *, alive: Collection[str] = (), timeout_s: float = 1.0
) -> Described:
    """All nodes, and of the tokens `alive` (keys) the silent ones; no streams."""
    described: list[NodeDescription] = []
    answered: set[str] = set()
    unreadable: list[DecodeError] = []
    for answer in session.ask(ALL_NODES_EVERYWHERE, timeout_s=timeout_s):
        if answer.refusal is None:
            answered.add(answer.key)
            try:
                described.append(read_node(session, answer))
            except DecodeError as error:
                unreadable.append(error)
    lost = {*alive} - answered
    silent = sorted(printable(full_name(key, session.settings.namespace)) for key in lost)
    return Described(tuple(described), tuple(silent), unreadable=tuple(unreadable))


def ask_streams(session: Session, *, timeout_s: float = 1.0) -> Described:
    """All streams, and the silent ones; no nodes."""
    alive = session.living(ALL_STREAMS_EVERYWHERE)
    described: dict[str, StreamDescription] = {}
    answered: set[str] = set()
    signed: set[str] = set()
    unreadable: list[DecodeError] = []
    for answer in ask_retained(session, ALL_STREAMS_EVERYWHERE, timeout_s=timeout_s):
        if answer.refusal is None:
            answered.add(answer.key)
            try:
                description, _ = read_description(answer.payload)
                if answer.sender == description.session:
                    signed.add(answer.key)
                elif answer.key in signed:
                    continue
                described[answer.key] = description
            except DecodeError as error:
                name = printable(stream_of(answer.key))
                unreadable.append(_unreadable(f"stream {name!r}", error))
    silent = sorted({*alive} - answered)
    return Described(streams=described, silent_streams=tuple(silent), unreadable=tuple(unreadable))


def frames_in_other_namespaces(session: Session) -> set[tuple[str, str]]:
    """Namespace and name of each frame in the descriptions of streams in namespaces below."""
    return {
        (namespace, frame)
        for key, stream in ask_streams(session).streams.items()
        if (namespace := namespace_of(key))
        for parent, child, _ in stream.frames
        for frame in (parent, child)
    }


def full_name_of(session: Session, node: str) -> str:
    """The full name of a node, given a name relative to the session's namespace or a full one."""
    namespace = session.settings.namespace
    name = relative_name(node, namespace)
    return name if name.startswith("/") else "/" + "/".join(filter(None, (namespace, name)))


def ask_node(
    session: Session, name: str, key: Callable[[str], str], payload: bytes | None = None
) -> list[Answer]:
    """The answers of the nodes of a name to a query at `key(name without its path)`, beside it;
    none of a node that is there and does not answer.

    Raises BusError with the nearest name if there is none. A node that is there is asked again: a
    link may be open before its far end has said on it what it serves.
    """
    at = key_beside(name, key, session.settings.namespace)
    deadline_s = scheduler.monotonic() + _SAID_WITHIN_S
    while not (answers := [*session.ask(at, payload, timeout_s=PATIENCE_S)]):
        present = list_nodes(session)
        if printable(full_name_of(session, name)) not in present:
            raise BusError(_absent(name, session, present))
        if scheduler.monotonic() >= deadline_s:
            break
        scheduler.sleep(_AGAIN_AFTER_S)
    return answers


def describe_nodes(session: Session, name: str) -> list[NodeDescription]:
    """The descriptions of the nodes of a full name: several if nodes share the name.

    Raises BusError with the nearest name if there is none, or if none answers in time; DecodeError
    if a description is unreadable.
    """
    answers = ask_node(session, name, node_key)
    described = [read_node(session, answer) for answer in answers if answer.refusal is None]
    if not described:
        why = next(filter(None, (answer.refusal for answer in answers)), "")
        raise BusError(f"node {name!r} did not answer{f': {why}' if why else ' in time'}")
    return described


def read_node(session: Session, answer: Answer) -> NodeDescription:
    """The description of a node in its answer. Raises DecodeError, with its name, if it cannot be
    read.
    """
    try:
        return decode_message(NodeDescription, answer.payload)
    except DecodeError as error:
        name = printable(full_name(answer.key, session.settings.namespace))
        raise _unreadable(f"node {name!r}", error) from error


def _unreadable(what: str, error: DecodeError) -> DecodeError:
    return DecodeError(f"the description of {what} is unreadable: {error}")


def watch_nodes(session: Session, callback: OnToken) -> Declaration:
    """Call `callback(full name, alive)` for each node that is alive, then at each change."""
    namespace = session.settings.namespace

    def on_token(key: str, alive: bool) -> None:
        callback(printable(full_name(key, namespace)), alive)

    return session.watch_living(ALL_NODES_EVERYWHERE, on_token)


class NodeWatch:
    """Knows at any time which nodes are alive, until `close()` or the session's end."""

    def __init__(self, session: Session):
        self._present: set[str] = set()
        self._changed = scheduler.Condition()
        self._subscriber = watch_nodes(session, self._on_node)

    def close(self) -> None:
        """End the watch."""
        self._subscriber.close()

    def names(self) -> frozenset[str]:
        """The full names of the nodes that are alive."""
        with self._changed:
            return frozenset(self._present)

    def wait(self, name: str, *, timeout_s: float | None = None) -> bool:
        """Wait for the node of this full name, at most `timeout_s`; whether it is alive."""
        with self._changed:
            return self._changed.wait_for(lambda: name in self._present, timeout_s)

    def _on_node(self, name: str, alive: bool) -> None:
        with self._changed:
            (self._present.add if alive else self._present.discard)(name)
            self._changed.notify_all()


def key_beside(name: str, key: Callable[[str], str], namespace: str) -> str:
    """The key of something of a node, `key(name without its path)`, in the node's namespace.

    `name` is relative to the namespace of the session that asks, or full.
    """
    path = relative_name(name, namespace)
    node = path.rpartition("/")[2]
    return f"{path.removesuffix(node)}{key(node)}"


def _absent(name: str, session: Session, present: list[str]) -> str:
    if not present:
        why = bus_out_of_reach(session) or "is it running, on this network?"
        return f"there is no node {name!r}, nor any other: {why}"
    return f"there is no node {name!r}{did_you_mean('/' + name.strip('/'), present)}"


# Others answer at once, and are asked again after 1 s.
_SCOUTED_WITHIN_S = 1.5


def bus_out_of_reach(session: Session) -> str:
    """Which endpoint to connect to does not answer; or if processes are that the session has no
    link to, since their bus is closed or its own is, and how to join them; "" for neither, or if
    scouting does not show them.

    For tools that have found nothing: it takes up to 1.5 s, or 2 s for each endpoint.
    """
    settings = session.settings
    for endpoint in settings.connect:
        if why := why_unreachable(endpoint):
            return (
                f"nothing answers at {endpoint} ({why}): start the router there, or correct "
                "--connect"
            )
    is_client = settings.mode == "client"
    if not has_scouting(settings):
        return ""
    is_closed = settings.closed is not None
    try:
        # A client has one link, to a router, and reaches all others by that.
        linked = session.linked() | {session.id}
        if is_client and len(linked) > 1:
            return ""

        def is_out(zid: str, endpoints: tuple[str, ...]) -> bool:
            return zid not in linked and bool(_what(endpoints, is_closed))

        found = scout(
            settings, _SCOUTED_WITHIN_S, until=is_out, what="router" if is_client else "peer|router"
        )
        # One that was met meanwhile is no stranger.
        linked |= session.linked()
        others = (endpoints for zid, endpoints in found.items() if is_out(zid, endpoints))
        return next((_what(endpoints, is_closed) for endpoints in others), "")
    except BusError:
        return ""


def _what(endpoints: tuple[str, ...], is_closed: bool) -> str:
    """The words for a process at these endpoints, to one on a closed bus or an open one; "" if
    the two could have a link.
    """
    if not endpoints:
        return ""
    # An address of IPv4 is the shorter one.
    at = printable(min(endpoints, key=lambda each: ("[" in each, each)))
    if not all(each.startswith("tls/") for each in endpoints):
        return f"an open bus is here ({at}): join it without --secure" if is_closed else ""
    if is_closed:
        return (
            f"a closed bus is here ({at}) that this identity gets no link to: join it by one of "
            "its authority"
        )
    return f"a closed bus is here ({at}): join it by --secure DIR"
