"""The ways of messages and declarations: peers and clients pass nothing on, routers do.

As in Zenoh each router tells all others its links, its peers and its declarations. A message
goes along the tree of shortest ways from the router that it came to first. If several routers
have a link to a peer, one of them passes on between it and further routers. Each passes on between
it and its own clients; these get the peer's messages a second time by the tree, unless their router
is that one (eclipse-zenoh/zenoh#409). No router passes anything between two peers, also if these
have no link to each other (eclipse-zenoh/zenoh#498).
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from tfbus.testing.declarations import KINDS, Keys

if TYPE_CHECKING:
    from tfbus.testing.links import Face
    from tfbus.testing.zenoh_session import ZenohSession


class Way(NamedTuple):
    """A face by which a message goes on, and its journey from there."""

    face: "Face"
    journey: "Journey"


@dataclass(frozen=True)
class Journey:
    """The journey of a message: its first router, and all routers that it crossed."""

    root: str = ""
    crossed: frozenset[str] = frozenset()


class Direct:
    """The routing of peers and clients: they pass nothing on."""

    def __init__(self, session: "ZenohSession") -> None:
        self._session = session

    def spread(self, source: object, kind: str, key: str, change: int) -> None:
        """Tell others of a declaration of the session itself."""
        if source is self._session:
            for face in self._session.faces.values():
                face.tell(kind, key, change)

    def sources(self) -> Iterator[tuple[object, dict[str, Keys]]]:
        """All sources of declarations, and the keys declared there."""
        own = self._session.declarations.own
        yield self._session, {kind: Keys(keys) for kind, keys in own.items()}
        for face in self._session.faces.values():
            yield face, face.declared

    def has(self, kind: str, full: str) -> bool:
        """Whether a declaration of another session meets a key."""
        return bool(self._session.declarations.heard[kind].met_by(full))

    def ways(
        self, kind: str, full: str, journey: Journey | None = None, came_by: "Face | None" = None
    ) -> list[Way]:
        """The faces by which a message goes on; without `journey` it is of this session."""
        if came_by is not None:
            return []
        faces = self._session.declarations.heard[kind].met_by(full)
        return [Way(face, Journey()) for face in faces if face.is_open]

    def greet(self, face: "Face") -> None:
        """Tell the far end of a new face all that it has to know."""
        own = self._session.declarations.own
        face.tell_all(
            (kind, key, count) for kind, keys in own.items() for key, count in keys.items()
        )

    def part(self, face: "Face") -> None:
        """A face has ended."""


class RoutingTable:
    """All that a router has told others, up to the change of this number."""

    def __init__(self, zid: str) -> None:
        self.zid = zid
        self.number = 0
        self.routers: dict[str, None] = {}
        self.peers: dict[str, None] = {}
        self.declared = {kind: Keys() for kind in KINDS}

    def copy(self) -> "RoutingTable":
        """The same, apart from later changes."""
        table = RoutingTable(self.zid)
        table.number = self.number
        table.routers = dict(self.routers)
        table.peers = dict(self.peers)
        table.declared = {kind: Keys(keys) for kind, keys in self.declared.items()}
        return table

    def wants(self, kind: str, full: str) -> bool:
        """Whether something of this kind that a key meets is declared there."""
        return self.declared[kind].meets(full)


class RouteChange(NamedTuple):
    """A change of a table. `kind` is of a declaration, or "router", or "peer"."""

    zid: str
    number: int
    kind: str
    key: str
    is_new: bool


class Router(Direct):
    """The routing of a router."""

    def __init__(self, session: "ZenohSession") -> None:
        super().__init__(session)
        self._own = RoutingTable(session.zid_text)
        self._tables: dict[str, RoutingTable] = {}
        # The other routers that a way leads to.
        self._reached: set[str] = set()
        # How often each key is declared here, by the session itself, its clients and peers.
        self._count: dict[tuple[str, str], int] = {}
        self._trees: dict[str, dict[str, list[str]]] = {}

    # Declarations

    def spread(self, source: object, kind: str, key: str, change: int) -> None:
        """Tell peers and clients, and other routers if it is of this one."""
        for face in self._leaves():
            if face is not source and not (_is_peer(face) and source in self._peers()):
                face.tell(kind, key, change)
        if not isinstance(source, RoutingTable):
            former = self._count.get((kind, key), 0)
            self._count[kind, key] = now = former + change
            if not now:
                del self._count[kind, key]
            if bool(former) != bool(now):
                self._publish(kind, key, is_new=bool(now))

    def sources(self) -> Iterator[tuple[object, dict[str, Keys]]]:
        """All sources of declarations, and the keys declared there."""
        yield from super().sources()
        for zid in sorted(self._reached):
            yield self._tables[zid], self._tables[zid].declared

    def has(self, kind: str, full: str) -> bool:
        """Whether a declaration of another session meets a key."""
        if super().has(kind, full):
            return True
        return any(self._tables[zid].wants(kind, full) for zid in self._reached)

    # Links

    def greet(self, face: "Face") -> None:
        """Tell the far end of a new face all that it has to know."""
        if _is_router(face):
            for table in (self._own, *self._tables.values()):
                self._send_table(face, table)
            self._publish("router", face.far_session.zid_text, is_new=True)
            return
        if _is_peer(face):
            self._publish("peer", face.far_session.zid_text, is_new=True)
        self._greet_leaf(face)

    def _greet_leaf(self, face: "Face") -> None:
        own = self._session.declarations.own
        face.tell_all(
            (kind, key, own[kind][key] if source is self._session else 1)
            for source, declared in self.sources()
            if source is not face and not (_is_peer(face) and source in self._peers())
            for kind, keys in declared.items()
            for key in keys
        )

    def part(self, face: "Face") -> None:
        """A face has ended."""
        zid = face.far_session.zid_text
        if _is_router(face):
            self._publish("router", zid, is_new=False)
        elif _is_peer(face):
            self._publish("peer", zid, is_new=False)

    def _leaves(self) -> "list[Face]":
        """The faces of peers and clients."""
        return [face for face in self._session.faces.values() if not _is_router(face)]

    def _peers(self) -> "list[Face]":
        return [face for face in self._leaves() if _is_peer(face)]

    def _router_faces(self) -> "list[Face]":
        return [face for face in self._session.faces.values() if _is_router(face)]

    # Tables

    def _publish(self, kind: str, key: str, *, is_new: bool) -> None:
        own = self._own
        change = RouteChange(own.zid, own.number + 1, kind, key, is_new)
        self._apply(own, change)
        self._pass_change(change, None)

    def _send_table(self, face: "Face", table: RoutingTable) -> None:
        sent = table.copy()
        size = 100 + 50 * sum(map(len, sent.declared.values()))
        face.send(lambda far: far.session.routing.hear_table(far, sent), size)

    def hear_table(self, face: "Face", table: RoutingTable) -> None:
        """A router tells all that it knows of itself or another one."""
        known = self._tables.get(table.zid)
        if table.zid == self._own.zid or (known is not None and known.number >= table.number):
            return
        if table.zid in self._reached:
            self._spread_table(self._tables[table.zid], -1)
            self._reached.discard(table.zid)
        self._tables[table.zid] = table.copy()
        for other in self._router_faces():
            if other is not face:
                self._send_table(other, table)
        self._find_trees()

    def _pass_change(self, change: RouteChange, came_by: "Face | None") -> None:
        for face in self._router_faces():
            if face is not came_by:
                face.send(lambda far: far.session.routing.hear_change(far, change))

    def hear_change(self, face: "Face", change: RouteChange) -> None:
        """A router tells a change of itself or another one."""
        if change.zid == self._own.zid:
            return
        table = self._tables.get(change.zid)
        if table is None:
            face.send(lambda far: far.session.routing.repeat_table(far, change.zid))
            return
        if change.number <= table.number:
            return
        self._apply(table, change)
        self._pass_change(change, face)

    def repeat_table(self, face: "Face", zid: str) -> None:
        """Another router lacks a table."""
        if zid in self._tables:
            self._send_table(face, self._tables[zid])

    def _apply(self, table: RoutingTable, change: RouteChange) -> None:
        table.number = change.number
        _, _, kind, key, is_new = change
        if kind == "router":
            _set(table.routers, key, is_new)
            self._find_trees()
        elif kind == "peer":
            _set(table.peers, key, is_new)
        else:
            _set(table.declared[kind], key, is_new)
            if table.zid in self._reached:
                self._session.declarations.spread(table, kind, key, 1 if is_new else -1)

    def _find_trees(self) -> None:
        """The links of routers have changed: find the reached routers anew, and the ways."""
        self._trees.clear()
        reached = set(self._tree(self._own.zid)) - {self._own.zid}
        former, self._reached = self._reached, reached
        for zid in sorted(former - reached):
            # It may have changed when it is reached again: then it is told anew.
            self._spread_table(self._tables.pop(zid), -1)
        for zid in sorted(reached - former):
            self._spread_table(self._tables[zid], 1)

    def _spread_table(self, table: RoutingTable, change: int) -> None:
        for kind, keys in table.declared.items():
            for key in list(keys):
                self._session.declarations.spread(table, kind, key, change)

    def _neighbours(self, zid: str) -> list[str]:
        """The routers that have a link to one, by the tables of both."""
        table = self._own if zid == self._own.zid else self._tables[zid]
        return [
            other
            for other in sorted(table.routers)
            if other == self._own.zid or (other in self._tables)
            if zid in (self._own if other == self._own.zid else self._tables[other]).routers
        ]

    def _tree(self, root: str) -> dict[str, list[str]]:
        """The children of each router in the tree of shortest ways from a root."""
        tree = self._trees.get(root)
        if tree is None:
            tree = self._trees[root] = {root: []}
            edge = [root]
            while edge:
                following = []
                for zid in edge:
                    for other in self._neighbours(zid):
                        if other not in tree:
                            tree[zid].append(other)
                            tree[other] = []
                            following.append(other)
                edge = following
        return tree

    # Messages

    def ways(
        self, kind: str, full: str, journey: Journey | None = None, came_by: "Face | None" = None
    ) -> list[Way]:
        """The faces by which a message goes on; without `journey` it is of this session."""
        own = self._own.zid
        is_onward = came_by is not None and _is_router(came_by) and journey is not None
        root = journey.root if journey is not None and is_onward else own
        crossed = journey.crossed if journey is not None else frozenset()
        onwards = Journey(root, crossed | {own})
        is_of_peer = came_by is not None and _is_peer(came_by)
        faces = [
            face
            for face in self._leaves()
            if face is not came_by and face.wants(kind, full)
            if not _is_peer(face) or (not is_of_peer and self._is_from(root, face))
        ]
        if came_by is None or not is_of_peer or self._serves(came_by):
            faces += self._onward_routers(kind, full, onwards)
        return [Way(face, onwards) for face in faces if face.is_open]

    def _is_from(self, root: str, face: "Face") -> bool:
        """Whether a message that came to the router `root` first reaches the peer at a face from
        here: each router passes on messages that came to it first, and one of them all else.
        """
        if root == self._own.zid:
            return True
        return root not in self._beside(face) and self._serves(face)

    def _serves(self, face: "Face") -> bool:
        """Whether this router is the one, of all that have a link to the peer at a face, that
        passes on between the peer and further routers.
        """
        return all(_rank(self._own.zid) > _rank(zid) for zid in self._beside(face))

    def _beside(self, face: "Face") -> list[str]:
        """The other routers that have a link to the peer at a face."""
        peer = face.far_session.zid_text
        return [zid for zid in self._reached if peer in self._tables[zid].peers]

    def _onward_routers(self, kind: str, full: str, journey: Journey) -> "list[Face]":
        if journey.root != self._own.zid and journey.root not in self._reached:
            return []
        tree = self._tree(journey.root)
        faces = {face.far_session.zid_text: face for face in self._router_faces()}
        return [
            faces[zid]
            for zid in tree.get(self._own.zid, ())
            if zid in faces and zid not in journey.crossed
            if self._wants_below(tree, zid, kind, full)
        ]

    def _wants_below(self, tree: dict[str, list[str]], zid: str, kind: str, full: str) -> bool:
        return self._tables[zid].wants(kind, full) or any(
            self._wants_below(tree, child, kind, full) for child in tree[zid]
        )


class Gateway(Router):
    """The routing of a client that listens, as the router of a site has it: its own clients are
    leaves, and so is its router, to which it is a client that declares all that they do.
    """

    def greet(self, face: "Face") -> None:
        """Tell the far end of a new face all that it has to know."""
        self._greet_leaf(face)

    def part(self, face: "Face") -> None:
        """A face has ended."""

    def _leaves(self) -> "list[Face]":
        return list(self._session.faces.values())

    def _router_faces(self) -> "list[Face]":
        return []


def routing_of(session: "ZenohSession") -> Direct:
    """The routing of a session of its mode."""
    if session.mode == "router":
        return Router(session)
    return Gateway(session) if session.mode == "client" and session.listen else Direct(session)


def _rank(zid: str) -> bytes:
    """The greatest of several routers serves a peer: Zenoh compares ids from their last byte on."""
    return int(zid, 16).to_bytes(16, "little")


def _is_router(face: "Face") -> bool:
    return face.far_session.mode == "router"


def _is_peer(face: "Face") -> bool:
    return face.far_session.mode == "peer"


def _set(entries: dict[str, None], key: str, is_there: bool) -> None:
    if is_there:
        entries[key] = None
    else:
        entries.pop(key, None)
