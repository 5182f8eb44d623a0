"""The sessions of a simulated network and the links between them: how they meet and part.

A link ends when an end has heard nothing for the lease, or as soon as it learns that the other end
is closed. The bus gets it from `zenoh_library.simulated()`.
"""

from dataclasses import dataclass
from functools import partial
from typing import Any

import zenoh

from tfbus.bus.settings import network_of
from tfbus.testing import publications
from tfbus.testing.callers import Handler
from tfbus.testing.links import LEASE_S, Face, LinkLane, Meeting, Paths, foreign_place
from tfbus.testing.processes import Host, Process
from tfbus.testing.queries import Cancellation
from tfbus.testing.tasks import SimulationError, Tasks
from tfbus.testing.zenoh_session import Scout, ZenohSession


@dataclass(slots=True)
class Faults:
    """How often Zenoh fails in ways that it is known for: 0 never, 1 on each occasion.

    - `lost_declarations`: a declaration of a queryable never arrives, at most one of each link
      (eclipse-zenoh/zenoh#2516).
    - `half_links`: of two that have lost each other, one links again before the other has noticed,
      and learns nothing of that one's declarations (eclipse-zenoh/zenoh#2806). It lasts for the
      lease, after which tfbus ends such a link (docs/internals/zenoh.md).
    - `late_tokens`: the news of a token comes up to a second late, after messages of its publisher,
      as was seen of hosts that are plugged in again.
    - `repeated_tokens`: the news of a token comes twice (eclipse-zenoh/zenoh#1438, #2071, #2523).
    - `short_queries`: the end of a query overtakes an answer, which is lost
      (eclipse-zenoh/zenoh-python#277).
    - `endless_queries`: the end of a query never comes, so that it ends by its timeout
      (eclipse-zenoh/zenoh#2454).
    - `deaf_links`: one end of a new link reads nothing, for four leases; then tfbus ends it.
    """

    lost_declarations: float = 0.0
    half_links: float = 0.0
    late_tokens: float = 0.0
    repeated_tokens: float = 0.0
    short_queries: float = 0.0
    endless_queries: float = 0.0
    deaf_links: float = 0.0


# A peer meets others within this time, and one that it has lost within the longer one.
_MEETS_WITHIN_S = 0.15
_MEETS_AGAIN_WITHIN_S = 4.0

# A peer that meets no others opens alone after this time, a client fails.
_OPENS_ALONE_S = 0.5

# News of a token that come late are at most so late.
_LATE_TOKEN_S = 1.0

# One that links again before the other has noticed that it was lost does it within this time.
_TOO_SOON_S = 0.3

# A link whose end reads nothing of it is ended after this time: three leases after a look that
# finds unread bytes, the first of which comes a lease after the link.
_DEAF_FOR_S = 4.0 * LEASE_S


class Fabric:
    """All sessions of a network, and their links."""

    def __init__(self, tasks: Tasks, paths: Paths, faults: Faults) -> None:
        self.tasks = tasks
        self._paths = paths
        self._faults = faults
        # Messages that congested links have dropped.
        self.dropped = 0
        self._sessions: dict[ZenohSession, None] = {}
        self._meeting = Meeting(paths)
        # Faces whose far end has lost the link, which they will not notice in time.
        self._unaware: set[Face] = set()

    # The bus opens sessions

    def declare_advanced_publisher(self, *args: Any, **options: Any) -> Any:
        """As Zenoh's extension."""
        return publications.declare_advanced_publisher(*args, **options)

    def declare_advanced_subscriber(self, *args: Any, **options: Any) -> Any:
        """As Zenoh's extension."""
        return publications.declare_advanced_subscriber(*args, **options)

    def new_cancellation(self) -> Cancellation:
        """As Zenoh's CancellationToken."""
        return Cancellation()

    def open_session(self, settings: Any, *, opens_alone: bool = False) -> ZenohSession:
        """Open a session in the process whose turn it is, as `zenoh.open`; a client without its
        router only if it `opens_alone`.
        """
        _check_settings(settings)
        process: Process = self.tasks.current.place
        session = ZenohSession(
            self,
            process,
            mode=settings.mode or "peer",
            namespace=settings.namespace,
            zid=f"a{process.urandom(15).hex()}",
            connect=tuple(settings.connect),
            listen=tuple(settings.listen),
            has_bad_network=network_of(settings.network).is_bad,
        )
        if place := foreign_place(session):
            raise zenoh.ZError(f"Can not listen on {place}: Cannot assign requested address")
        process.sessions.append(session)
        self._sessions[session] = None
        self._meet_others(session, _MEETS_WITHIN_S)
        deadline_ns = self.tasks.now_ns + round(_OPENS_ALONE_S * 1e9)
        is_client = session.mode == "client"
        has_met = partial(self._meeting.has_router, session) if is_client else session.faces.__len__
        while not has_met() and self.tasks.now_ns < deadline_ns:
            self.tasks.wait("others on the network", 0.02)
        if is_client and not (has_met() or opens_alone):
            self._sessions.pop(session, None)
            raise zenoh.ZError("Unable to connect to any of the routers")
        return session

    def scout(self, handler: Any, what: str) -> Scout:
        """Ask who is there, as `zenoh.scout`: sessions answer if multicast gets to them."""
        scout = Scout(self.tasks.current.place, Handler(handler))
        for session in self._sessions:
            paths = self._paths.both_ways(scout.process.host, session.process.host)
            if session.mode in what.split("|") and all(p.is_up and p.multicast for p in paths):
                answer = partial(scout.hear, session)
                self.tasks.call_after(sum(path.delay_s for path in paths), answer)
        return scout

    def leave(self, session: ZenohSession) -> None:
        """A session closes: others know at once."""
        for face in list(session.faces.values()):
            face.send(lambda far: self.lose(far))
            self._close(face)
            # Where the news of its end does not come, no keep-alive does either.
            self._watch_silence(face.far, face.lane.lost_after_s())
        self._sessions.pop(session, None)

    # Asked by sessions

    def loses_declaration(self) -> bool:
        """Whether a declaration of a queryable is lost now."""
        return self._happens(self._faults.lost_declarations)

    def times_of_a_token(self) -> int:
        """How often the news of a token are told."""
        return 2 if self._happens(self._faults.repeated_tokens) else 1

    def late_of_a_token_s(self) -> float:
        """How late the news of a token are."""
        if not self._happens(self._faults.late_tokens):
            return 0.0
        return self.tasks.random.uniform(0.0, _LATE_TOKEN_S)

    def ends_short(self) -> bool:
        """Whether the end of a query overtakes an answer now."""
        return self._happens(self._faults.short_queries)

    def never_ends(self) -> bool:
        """Whether the end of a query is lost now."""
        return self._happens(self._faults.endless_queries)

    def _happens(self, share: float) -> bool:
        return bool(share) and self.tasks.random.random() < share

    def round_trip_s(self, session: ZenohSession) -> float:
        """How long the farthest of its links takes to answer."""
        here = session.process.host
        paths = [self._paths.between(here, far.process.host) for far in session.faces]
        return 2 * max((path.delay_s + path.jitter_s for path in paths), default=0.0)

    # Events of hosts, processes and paths

    def process_ended(self, process: Process) -> None:
        """A process has ended at once: its host closes its sockets."""
        for session in process.sessions:
            for face in list(session.faces.values()):
                far = face.far
                face.is_open = False
                if face.lane.is_reliable:
                    face.lane.send(partial(far.session.process.receive, partial(self.lose, far)))
                # Where the news of its end does not come either, no keep-alive does.
                self._watch_silence(far, face.lane.lost_after_s())
            session.faces.clear()
            self._sessions.pop(session, None)

    def process_vanished(self, process: Process) -> None:
        """A process is gone without a word to others."""
        for session in process.sessions:
            for face in list(session.faces.values()):
                face.is_open = face.lane.is_open = False
                self._watch_silence(face.far)
            session.faces.clear()
            self._sessions.pop(session, None)

    def process_stopped(self, process: Process) -> None:
        """A process says nothing more."""
        for session in process.sessions:
            for face in list(session.faces.values()):
                self._watch_silence(face.far)

    def process_goes_on(self, process: Process) -> None:
        """A stopped process goes on."""
        for session in process.sessions:
            self._meet_others(session, _MEETS_AGAIN_WITHIN_S)

    def set_up(self, one: Host, other: Host, is_up: bool) -> None:
        """Let all pass from one host to another, or nothing."""
        path = self._paths.between(one, other)
        if one is other or path.is_up == is_up:
            return
        path.is_up = is_up
        if not is_up:
            path.changed_ns = self.tasks.now_ns
        for session in self._sessions_of(one):
            for face in list(session.faces.values()):
                if face.far_session.process.host is other:
                    if is_up:
                        face.lane.release()
                    else:
                        self._watch_silence(face.far)
            if is_up:
                self._meet_others(session, _MEETS_AGAIN_WITHIN_S)

    def address_changed(self, host: Host) -> None:
        """The addresses of a host's links are gone: it ends them, the others hear nothing more."""
        for session in self._sessions_of(host):
            for face in list(session.faces.values()):
                if face.far_session.process.host is not host:
                    face.lane.is_open = face.far.lane.is_open = False
                    self._close(face)
                    self._watch_silence(face.far)
                    self._meet_others(face.far_session, _MEETS_AGAIN_WITHIN_S)
            self._meet_others(session, _MEETS_AGAIN_WITHIN_S)

    def _sessions_of(self, host: Host) -> list[ZenohSession]:
        return [session for session in self._sessions if session.process.host is host]

    # Who meets

    def _meet_others(self, session: ZenohSession, within_s: float) -> None:
        # Of hundreds nearly all are known: only the others are looked at, in an order of the seed.
        others = self._sessions.keys() - session.faces.keys() - session.looks_for - {session}
        for other in sorted(others, key=lambda each: each.zid_text):
            if self._meeting.protocol(session, other):
                self._meet_soon(session, other, within_s)

    def _meet_soon(self, one: ZenohSession, other: ZenohSession, within_s: float) -> None:
        pair = (one, other) if one.zid_text > other.zid_text else (other, one)
        one.looks_for.add(other)
        other.looks_for.add(one)

        def try_it() -> None:
            one.looks_for.discard(other)
            other.looks_for.discard(one)
            are_there = all(session in self._sessions for session in pair)
            # Where nothing passes, healing begins it again.
            if are_there and self._can_talk(*pair) and not self._are_linked(*pair):
                protocol = self._meeting.protocol(*pair)
                if protocol:
                    self._link(*pair, is_reliable=protocol != "udp")

        self.tasks.call_after(self.tasks.random.uniform(0.001, within_s), try_it)

    def _are_linked(self, one: ZenohSession, other: ZenohSession) -> bool:
        return other in one.faces and one in other.faces

    def _can_talk(self, one: ZenohSession, other: ZenohSession) -> bool:
        paths = self._paths.both_ways(one.process.host, other.process.host)
        are_up = all(path.is_up for path in paths)
        return are_up and one.process.is_running and other.process.is_running

    def _link(self, one: ZenohSession, other: ZenohSession, *, is_reliable: bool) -> None:
        faces = []
        for near, far in ((one, other), (other, one)):
            path = self._paths.between(near.process.host, far.process.host)
            faces.append(Face(near, LinkLane(self.tasks, path, is_reliable=is_reliable)))
        faces[0].far, faces[1].far = faces[1], faces[0]
        unaware = [self._take_over(face) for face in faces]
        for face, is_unaware in zip(faces, unaware, strict=True):
            if not is_unaware:
                face.session.greet(face)
        if self._happens(self._faults.deaf_links):
            self._deafen(self.tasks.random.choice(faces))
        self._meeting.note_link(one, other)
        for session in (one, other):
            # Each may be introduced now to the sessions that the other knows.
            self._meet_others(session, _MEETS_WITHIN_S)

    def _take_over(self, face: Face) -> bool:
        """A new link in the place of a former one; whether its end has not noticed any loss."""
        session = face.session
        stale = session.faces.get(face.far_session)
        if stale is None:
            return False
        if stale not in self._unaware:
            self._close(stale)
            return False
        self._unaware.discard(stale)
        stale.is_open = False
        face.continue_of(stale)
        session.faces[face.far_session] = face
        # Tfbus ends the connection, for both: no half link follows from that.
        self._end_later(face, LEASE_S)
        return True

    def _deafen(self, face: Face) -> None:
        """Let this end of a link read nothing, until tfbus ends it."""
        face.is_deaf = True
        self._end_later(face, _DEAF_FOR_S)

    def _end_later(self, face: Face, after_s: float) -> None:
        """End a connection at this end, as tfbus does."""
        receive = face.session.process.receive
        self.tasks.call_after(after_s, lambda: receive(lambda: self.lose(face, is_ended=True)))

    # Who is lost

    def _close(self, face: Face) -> None:
        """This end of a link is closed; earlier messages still arrive."""
        if face.is_open:
            face.is_open = False
            self._unaware.discard(face)
            face.session.part(face)

    def lose(self, face: Face, *, is_ended: bool = False) -> None:
        """This end learns that its link is lost, or ends it; both sides meet again if they can."""
        if not face.is_open:
            return
        self._close(face)
        face.lane.is_open = False
        one, other = face.session, face.far_session
        within_s = _MEETS_AGAIN_WITHIN_S
        if face.far.is_open:
            there, here = other.process.host, one.process.host
            if not is_ended and self._happens(self._faults.half_links):
                self._unaware.add(face.far)
                within_s = _TOO_SOON_S
            # Its connection is closed: it learns that as soon as anything passes.
            passes = self._paths.between(here, there).is_up and face.far not in self._unaware
            self._watch_silence(face.far, 0.0 if passes else LEASE_S)
        for session in (one, other):
            if session in self._sessions:
                self._meet_others(session, within_s)

    def _watch_silence(self, face: Face, after_s: float = LEASE_S) -> None:
        """Lose the link of a face that has heard nothing for the lease."""
        far = face.far
        path = self._paths.between(far.session.process.host, face.session.process.host)

        def look() -> None:
            if not face.is_open or face.session.process.is_dead:
                return
            quiet_ns = self.tasks.now_ns - path.changed_ns
            is_silent = not far.is_open or not far.session.process.is_running
            if is_silent or (not path.is_up and quiet_ns >= round(after_s * 1e9)):
                face.session.process.receive(lambda: self.lose(face))

        self.tasks.call_after(max(after_s, path.delay_s), look)


def _check_settings(settings: Any) -> None:
    """Refuse settings that have no effect here."""
    if settings.closed is not None:
        raise SimulationError(
            f"a closed bus is not simulated: node {settings.name!r} must not have `secure` "
            f"({settings.secure})"
        )
    if settings.config:
        raise SimulationError(
            f"configuration files of Zenoh are not simulated: node {settings.name!r} must not have "
            f"`config` ({settings.config}), but may have mode, connect, listen and namespace"
        )
