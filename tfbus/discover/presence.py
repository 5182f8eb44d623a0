"""Who is there: the nodes on the bus, and what each tells about itself."""

import difflib
import threading
from collections.abc import Callable

from tfbus.bus.query import Answer
from tfbus.bus.retained import ask_retained
from tfbus.bus.session import Session
from tfbus.errors import BusError, DecodeError
from tfbus.wire.codec import decode_message
from tfbus.wire.descriptions import NodeDescription, StreamDescription
from tfbus.wire.keys import ALL_STREAMS_EVERYWHERE, full_name, node_key, stream_of

# The nodes of this namespace and of those below it.
_ALL_NODES = "**/@tfbus/node/*"


def list_nodes(session: Session) -> list[str]:
    """The full names of the nodes that are alive, sorted: `/sim`, `/robot7/sim`."""
    namespace = session.settings.namespace
    return sorted(full_name(key, namespace) for key in session.living(_ALL_NODES))


def describe_nodes(session: Session, name: str) -> list[NodeDescription]:
    """What the nodes of a full name tell about themselves: several where nodes share the name.

    Raises BusError where there is none, with the nearest names; DecodeError where what one tells
    cannot be read.
    """
    key = _key_of(name, session.settings.namespace)
    answers = session.ask(key, timeout_s=2.0)
    described = [_read(session, answer) for answer in answers if answer.refusal is None]
    if not described:
        raise BusError(_absent(name, list_nodes(session)))
    return described


def describe_all(
    session: Session,
    on_unreadable: Callable[[DecodeError], object],
    *,
    timeout_s: float = 1.0,
) -> list[NodeDescription]:
    """What all nodes tell about themselves; `on_unreadable(error)` is called for the others."""
    described = []
    for answer in session.ask(_ALL_NODES, timeout_s=timeout_s):
        if answer.refusal is None:
            try:
                described.append(_read(session, answer))
            except DecodeError as error:
                on_unreadable(error)
    return described


def describe_streams(
    session: Session,
    on_unreadable: Callable[[DecodeError], object],
    *,
    timeout_s: float = 1.0,
) -> dict[str, StreamDescription]:
    """What all streams tell about themselves, by the keys where they do.

    `on_unreadable(error)` is called for those that cannot be read.
    """
    described = {}
    for answer in ask_retained(session, ALL_STREAMS_EVERYWHERE, timeout_s=timeout_s):
        if answer.refusal is None:
            try:
                described[answer.key] = decode_message(StreamDescription, answer.payload)
            except DecodeError as error:
                name = stream_of(answer.key)
                told = f"what stream {name!r} tells about itself cannot be read: {error}"
                on_unreadable(DecodeError(told))
    return described


def _read(session: Session, answer: Answer) -> NodeDescription:
    try:
        return decode_message(NodeDescription, answer.payload)
    except DecodeError as error:
        name = full_name(answer.key, session.settings.namespace)
        raise DecodeError(
            f"what node {name!r} tells about itself cannot be read: {error}"
        ) from error


class NodeWatch:
    """Knows at any time which nodes are there; closed by `close()` or the session's end."""

    def __init__(self, session: Session):
        self._namespace = session.settings.namespace
        self._present: set[str] = set()
        self._changed = threading.Condition()
        self._subscriber = session.watch_living(_ALL_NODES, self._on_token)

    def close(self) -> None:
        """Watch no more."""
        self._subscriber.close()

    def is_present(self, name: str) -> bool:
        """Whether the node of this full name is there."""
        with self._changed:
            return name in self._present

    def wait(self, name: str, *, timeout_s: float | None = None) -> bool:
        """Whether the node of this full name is there, waited for at most `timeout_s`."""
        with self._changed:
            return self._changed.wait_for(lambda: name in self._present, timeout_s)

    def _on_token(self, key: str, alive: bool) -> None:
        name = full_name(key, self._namespace)
        with self._changed:
            (self._present.add if alive else self._present.discard)(name)
            self._changed.notify_all()


def relative_name(name: str, namespace: str) -> str:
    """A node's name as it is written within the namespace: `/robot7/sim` is `sim` in robot7.

    Raises BusError for a node outside the namespace: it cannot be reached from there.
    """
    path = name.strip("/")
    if not namespace or not name.startswith("/"):
        return path
    if not path.startswith(f"{namespace}/"):
        raise BusError(
            f"node {name!r} lies outside of the namespace {namespace!r}: leave --namespace away"
        )
    return path.removeprefix(f"{namespace}/")


def _key_of(name: str, namespace: str) -> str:
    prefix, _, node = relative_name(name, namespace).rpartition("/")
    return "/".join(filter(None, (prefix, node_key(node))))


def _absent(name: str, present: list[str]) -> str:
    if not present:
        return f"there is no node {name!r}, nor any other: is it running, on this network?"
    close = difflib.get_close_matches("/" + name.strip("/"), present, n=1)
    hint = f"did you mean {close[0]!r}?" if close else f"there are: {', '.join(present)}"
    return f"there is no node {name!r}; {hint}"
