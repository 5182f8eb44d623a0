"""A node among others: its description for them, and its warnings of its surroundings: another of
its name, endpoints that do not answer, few open files, members without rights. And its error if
another process has its id.
"""

import logging
import os
import socket
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import Any, TypeVar

from tfbus.base import scheduler
from tfbus.base.clock import Timer
from tfbus.base.errors import BusError, DecodeError
from tfbus.base.executor import Executor
from tfbus.base.installation import installed_version
from tfbus.base.log import LogOnce
from tfbus.base.wording import counted, listed, printable
from tfbus.bus.links import why_unreachable
from tfbus.bus.query import Answer, Query
from tfbus.bus.session import Session
from tfbus.bus.settings import NodeSettings
from tfbus.bus.zenoh_config import id_in_file
from tfbus.node.endpoint import NodeEndpoint
from tfbus.node.parameters import Parameters
from tfbus.wire.codec import decode_message, encode_map
from tfbus.wire.descriptions import FILLED_BY_OTHERS, NodeDescription
from tfbus.wire.keys import clock_key, node_key

# After a link to another process has opened, its declarations take a moment to arrive.
_CHECK_AFTER_S = 0.3


# So many nodes of one name are warned of.
_MOST_NAMED = 20


class DuplicateNameWatch:
    """Warns once of each other node of this node's name: requests may reach either of them.

    A node that is there when this one starts was first, whatever the clocks say. Of two nodes that
    meet later, when two networks join, the one that started later warns.
    """

    def __init__(
        self,
        name: str,
        full_name: str,
        started_ns: int,
        session: Session,
        executor: Executor,
        log: logging.Logger,
    ):
        self._name = name
        self._full_name = full_name
        self._started_ns = started_ns
        self._session = session
        self._executor = executor
        self._log = log
        self._once = LogOnce(log)
        self._named: set[str] = set()
        self._check: Timer = executor.after(_CHECK_AFTER_S, self._ask)
        session.watch_links(self._ask_soon)
        self._ask(at_start=True)

    def _ask_soon(self) -> None:
        if self._check.cancelled:
            self._check = self._executor.after(_CHECK_AFTER_S, self._ask)

    def _ask(self, *, at_start: bool = False) -> None:
        def on_answer(answer: Answer) -> None:
            if answer.refusal is not None:
                return
            try:
                other = decode_message(NodeDescription, answer.payload)
            except DecodeError as error:
                self._once.warning(
                    "answer",
                    "Ignored another description of node %s: %s",
                    self._full_name,
                    printable(str(error), 400),
                )
                return
            self._compare(other, at_start)

        key = node_key(self._name)
        with suppress(BusError):  # the session may be closed meanwhile, where the node is not
            self._session.ask_later(key, None, on_answer, lambda: None, timeout_s=1.0, others=True)

    def _compare(self, other: NodeDescription, at_start: bool) -> None:
        is_second = at_start or (self._started_ns, self._session.id) > (
            other.started_ns,
            other.session,
        )
        is_new = other.session not in {*self._named, self._session.id}
        # Answers come from others, who may make up sessions without end.
        if is_new and is_second and len(self._named) < _MOST_NAMED:
            self._named.add(other.session)
            self._log.warning(
                "There is another node %s, on %s with pid %s: give this one another name "
                "(--name), or a namespace (--namespace)",
                self._full_name,
                other.host,
                other.pid,
            )


# A busy machine finds the others late: while no node answers, the question is repeated.
_FOUND_WITHIN_S = 2.0
_AGAIN_AFTER_S = 0.1


def check_id_is_free(settings: NodeSettings, log: logging.Logger, patience_s: float) -> None:
    """Raise BusError if a node on the bus has the id that the configuration file sets.

    A session with an id of its own looks first: one with the same id would take the place of the
    other, without a word. If no node answers it looks for 2 s, at most `patience_s`. If the
    file sets no id, there is nothing to do.
    """
    taken = id_in_file(settings.config)
    if taken is None:
        return
    from tfbus.bus.presence import ask_nodes  # few files set an id

    with Session(settings, log, patience_s=patience_s, is_second=True) as session:
        session.settle()
        deadline_s = scheduler.monotonic() + min(patience_s, _FOUND_WITHIN_S)
        while not (others := ask_nodes(session).nodes) and scheduler.monotonic() < deadline_s:
            scheduler.sleep(_AGAIN_AFTER_S)
    for other in others:
        if other.session == taken:
            raise BusError(
                f"{settings.config} sets Zenoh's id {taken}, which node "
                f"'{printable(other.name)}' on {printable(other.host)} with pid {other.pid} "
                "has: remove 'id' from the file, or give each process its own"
            )


# A router that is started together with the node answers by then.
_AFTER_S = 5.0


def watch_endpoints(session: Session, executor: Executor, log: logging.Logger) -> None:
    """Look once, after some seconds, unless a router is connected by then; to a router an endpoint
    that answers without a link is worth a word, too. A client waits for its router, and says so
    itself.
    """
    endpoints = session.settings.connect
    if session.settings.mode == "client" or not endpoints:
        return

    def check() -> None:
        with suppress(BusError):  # it is closed meanwhile
            if not session.routers():
                # A host that is not there takes 2 s, in which callbacks of the node go on.
                scheduler.Thread(target=ask, name="endpoints", daemon=True).start()

    def ask() -> None:
        whys = {endpoint: why_unreachable(endpoint) for endpoint in endpoints}
        if silent := [f"{endpoint} ({why})" for endpoint, why in whys.items() if why]:
            executor.submit("endpoints", warn, silent)
        elif session.settings.mode == "router":
            executor.submit("endpoints", warn_of_no_link)

    def warn_of_no_link() -> None:
        with suppress(BusError):
            if not session.routers():
                log.warning(
                    "%s answers, and gives no link: is it the address of this router itself, or of "
                    "another bus?",
                    listed(endpoints),
                )

    def warn(silent: list[str]) -> None:
        with suppress(BusError):
            links = counted(len(session.linked()), "link")
            log.warning(
                "Nothing answers at %s: still trying; %s to other processes without it",
                listed(silent),
                links,
            )

    executor.after(_AFTER_S, check)


# A router that is restarted is back by then.
_ROUTER_GONE_S = 3.0
_SAY_AGAIN_AFTER_S = 60.0


def watch_router(session: Session, executor: Executor, log: logging.Logger) -> None:
    """Of a client, log that its router is gone, and that it has one again."""
    if session.settings.mode != "client":
        return
    once, is_gone = LogOnce(log, again_s=_SAY_AGAIN_AFTER_S), False

    def check() -> None:
        nonlocal is_gone
        with suppress(BusError):  # it is closed meanwhile
            was_gone, is_gone = is_gone, not session.routers()
            if is_gone and not was_gone:
                where = listed(session.settings.connect) or "a router"
                once.warning(
                    "gone",
                    "No link to %s, which is tried again: nothing is sent or received",
                    where,
                )
            elif was_gone and not is_gone:
                once.info("back", "Linked to a router again")

    def check_later() -> None:
        executor.after(_ROUTER_GONE_S, check)

    session.watch_links(check_later)


# So few that the next processes may not find room.
_FEW = 8


class OpenFilesWatch:
    """Warns once if this process comes to its limit of open files.

    Zenoh says nothing if it cannot open another link: the processes beyond are never seen.
    """

    def __init__(self, log: logging.Logger) -> None:
        self._log = log
        self._has_warned = False

    def check(self) -> None:
        """Compare the open files with the limit, as after a link has opened."""
        if self._has_warned or sys.platform == "win32":
            return
        import resource

        limit = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
        used = limit  # where it is reached, they cannot be listed either
        with suppress(OSError):
            used = len(os.listdir("/dev/fd"))
        if limit - used < _FEW and limit != resource.RLIM_INFINITY:
            self._has_warned = True
            self._log.warning(
                "%d of %d open files are in use: further processes on the bus may stay unseen. "
                "Raise the limit (ulimit -n 4096), or use a router (--mode client)",
                used,
                limit,
            )


def watch_members(session: Session, log: logging.Logger) -> None:
    """Log each identity without rights that opens a link, once; nothing on an open bus.

    Its certificate is by the authority, so it gets a link. Zenoh takes nothing from it.
    """
    closed = session.settings.closed
    if closed is None:
        return
    once, known = LogOnce(log), closed.rights.identities

    def check() -> None:
        for name in session.identities().values():
            identity = known.get(name)
            if identity is None:
                why = "its name is not in the rights of this process"
            elif identity.revoked:
                why = f"it was revoked on {identity.revoked}"
            else:
                continue
            once.warning(
                ("no rights", name),
                "Identity '%s' opened a link, and has no rights: %s. Nothing is taken from it",
                printable(name, 64),
                why,
            )

    session.watch_links(check)


# Returns entries for fields of the description.
Describer = Callable[[], Mapping[str, Sequence[Any]]]

E = TypeVar("E", bound=NodeEndpoint)


class NodeInfo:
    """A node's description, the fields of a NodeDescription, and its system's clock, on the bus.

    `describers` add facts that the node itself does not know; several values of a field are joined.
    """

    def __init__(
        self, name: str, full_name: str, started_ns: int, session: Session, parameters: Parameters
    ) -> None:
        self.describers: list[Describer] = []
        self._name = name
        self._full_name = full_name
        self._started_ns = started_ns
        self._session = session
        self._parameters = parameters
        self._lock = scheduler.Lock()
        self._endpoints: dict[str, list[NodeEndpoint]] = {
            kind: [] for kind in ("publishes", "subscribes", "serves", "calls")
        }
        # The description at the last query, and when it was noticed that it had changed.
        self._lasting, self._changed_s = b"", 0.0
        session.queryable(node_key(name), self._on_info_query)
        session.queryable(clock_key(name), self._on_clock_query)

    def add(self, kind: str, endpoint: E) -> E:
        """List the endpoint for as long as it is open, and return it."""
        with self._lock:
            is_open = [each for each in self._endpoints[kind] if not each.closed]
            self._endpoints[kind] = [*is_open, endpoint]
        return endpoint

    def describe(self) -> dict[str, Any]:
        """The node's name, host and current endpoints."""
        described: dict[str, list[Any]] = {field: [] for field in FILLED_BY_OTHERS}
        for describe in list(self.describers):
            for field, entries in describe().items():
                described.setdefault(field, []).extend(entries)
        return {
            "name": self._full_name,
            "host": socket.gethostname(),
            "pid": os.getpid(),
            "version": installed_version(),
            "session": self._session.id,
            "started_ns": self._started_ns,
            **self._membership(),
            **described,
            "parameters": [parameter.describe() for parameter in self._parameters],
            **{
                kind: {each.name: each.type_name for each in endpoints if not each.closed}
                for kind, endpoints in self._endpoints.items()
            },
            "retained": [
                each.name
                for each in self._endpoints["publishes"]
                if each.retained and not each.closed
            ],
        }

    def _definitions(self) -> dict[str, str]:
        """The definitions of the types of its publishers, by name."""
        open_ones = [each for each in self._endpoints["publishes"] if not each.closed]
        return {each.type_name: each.definition for each in open_ones if each.definition}

    def _membership(self) -> dict[str, str]:
        """Which identity it is on a closed bus, and which rights it enforces."""
        closed = self._session.settings.closed
        if closed is None:
            return {}
        return {"identity": closed.identity.name, "rights": closed.digest}

    def _on_info_query(self, query: Query) -> None:
        with query.answering("the description of the node"):
            described = self.describe()
            if self._has_changed(described, query.parameter("changed")):
                if query.parameter("definitions"):
                    described["definitions"] = self._definitions()
                query.answer(node_key(self._name), encode_map(described))

    def _has_changed(self, described: dict[str, Any], within: str | None) -> bool:
        """Whether the description has changed in the last seconds, by more than the counts of
        filters and failures; True if no number is given.
        """
        lasting, now_s = (
            encode_map({**described, "filters": (), "failures": ()}),
            scheduler.monotonic(),
        )
        with self._lock:
            if lasting != self._lasting:
                self._lasting, self._changed_s = lasting, now_s
            try:
                return now_s - self._changed_s <= float(within or "inf")
            except ValueError:
                return True

    def _on_clock_query(self, query: Query) -> None:
        received_ns = scheduler.time_ns()
        times = {"received": received_ns, "now": scheduler.time_ns()}
        query.answer(clock_key(self._name), encode_map(times))
        query.close()
