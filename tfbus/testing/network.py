"""A simulated network: hosts, the paths between them, what runs there, and what goes wrong.

    with Network(seed=1) as network:
        robot, base = network.host("robot"), network.host("base")
        network.path(robot, base, delay_s=0.02, loss=0.05)
        with robot.process("sim"):
            node = tfbus.Node("sim")
        network.run(10.0)

The real code runs on it, in virtual time, one task at a time. The same seed gives the same run.
"""

import gc
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from types import TracebackType
from typing import Any

import zenoh

from tfbus.bus import zenoh_library
from tfbus.runtime import scheduler
from tfbus.testing import primitives, retained
from tfbus.testing.event_loop import SimulatedEventLoop
from tfbus.testing.links import LEASE_S, Lane, Link, Path
from tfbus.testing.of_python import standing_in
from tfbus.testing.processes import START_NS, Host, Process
from tfbus.testing.tasks import SimulationError, Task, Tasks
from tfbus.testing.zenoh_session import Cancellation, Face, ZenohSession

# A peer meets others within this time, and one that it has lost within the longer one.
_MEETS_WITHIN_S = 0.15
_MEETS_AGAIN_WITHIN_S = 4.0

# A peer that meets no others opens alone after this time, a client fails.
_OPENS_ALONE_S = 0.5

# How often a condition is looked at while the network runs.
_LOOK_EVERY_S = 0.005


class Network:
    """Hosts and all that runs on them, from a seed; in force until the end of its `with`.

    `interleaving` is the mean number of steps after which a task gives its turn away without need.
    """

    def __init__(self, seed: int = 0, *, interleaving: int = 50) -> None:
        self.seed = seed
        self._interleaving = interleaving
        self._stack = ExitStack()
        self.dropped = 0
        # The share of declarations of queryables that are lost (eclipse-zenoh/zenoh#2516).
        self.lost_declarations = 0.0
        self._hosts: dict[str, Host] = {}
        self._paths: dict[tuple[Host, Host], Path] = {}
        self._default = Path()
        self._sessions: dict[ZenohSession, None] = {}
        self._meeting: set[tuple[ZenohSession, ZenohSession]] = set()
        self._pids = 1000

    # In force

    def __enter__(self) -> "Network":
        if scheduler.is_simulated:
            raise SimulationError("one simulated network at a time")
        place = _Driver()
        self.tasks = Tasks(self.seed, place, interleaving=self._interleaving)
        self._was_collecting = gc.isenabled()
        gc.disable()  # finalizers at any moment would make no two runs the same
        self.outside = self.host("outside")
        self.tasks.main.place = self._new_process(self.outside, "main")
        main = primitives.Thread(self.tasks, name="MainThread")
        main._task = self.tasks.main
        self.tasks.main.thread = main
        names = self._replacements()
        self._stack.enter_context(scheduler.replaced_by(names))
        self._stack.enter_context(standing_in(self.tasks, names))
        self._stack.enter_context(zenoh_library.replaced_by(self))
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            self.tasks.end()
        finally:
            self._stack.close()
            if self._was_collecting:
                gc.enable()
        failure, self.tasks.failure = self.tasks.failure, None
        if failure is not None and error is None:
            raise failure

    def _replacements(self) -> dict[str, Any]:
        tasks = self.tasks

        def process() -> Process:
            return tasks.current.place  # type: ignore[return-value]

        def sleep(seconds: float) -> None:
            tasks.wait("the end of a sleep", max(seconds, 0.0))

        return {
            "monotonic": lambda: tasks.now_ns / 1e9 + 1000.0,
            "monotonic_ns": lambda: tasks.now_ns + 1000 * 10**9,
            "time_ns": lambda: process().host.time_ns(),
            "sleep": sleep,
            "Lock": partial(primitives.Lock, tasks),
            "RLock": partial(primitives.Lock, tasks, reentrant=True),
            "Event": partial(primitives.Event, tasks),
            "Condition": partial(primitives.Condition, tasks),
            "Queue": partial(primitives.Queue, tasks),
            "SimpleQueue": partial(primitives.Queue, tasks),
            "Thread": partial(primitives.Thread, tasks),
            "current_thread": lambda: tasks.current.thread,
            "main_thread": lambda: None,
            "getpid": lambda: process().pid,
            "new_event_loop": lambda: SimulatedEventLoop(tasks),
            "urandom": lambda size: process().urandom(size),
        }

    # Hosts and processes

    def host(self, name: str, *, offset_s: float = 0.0, drift_ppm: float = 0.0) -> Host:
        """The host of this name, made the first time: its clock is `offset_s` ahead of the others
        and gains `drift_ppm` microseconds a second.
        """
        if name not in self._hosts:
            host = Host(self.tasks, name, offset_s=offset_s, drift_ppm=drift_ppm)
            self._hosts[name] = host
        return self._hosts[name]

    def _new_process(self, host: Host, name: str) -> Process:
        self._pids += 1
        process = Process(self.tasks, host, name, self._pids)
        host.processes.append(process)
        return process

    @contextmanager
    def process(self, host: Host | str, name: str) -> Iterator[Process]:
        """What is called until the end of the `with` happens in a new process of the host."""
        process = self._new_process(self._host(host), name)
        with self.tasks.within(process):
            yield process

    @contextmanager
    def within(self, process: Process) -> Iterator[None]:
        """What is called until the end of the `with` happens in the process."""
        with self.tasks.within(process):
            yield

    def start(
        self, host: Host | str, name: str, main: Callable[..., object], *args: Any, **named: Any
    ) -> Process:
        """Start a process that runs `main(*args, **named)` and ends with it."""
        process = self._new_process(self._host(host), name)

        def run() -> None:
            try:
                main(*args, **named)
            finally:
                if not self.tasks.is_over:
                    self._end(process)

        process.main = self.tasks.start(name, process, run)
        return process

    def kill(self, process: Process) -> None:
        """End a process at once, as SIGKILL does: its host closes its sockets."""
        self._end(process)

    def power_off(self, host: Host | str) -> None:
        """End all processes of a host without a word to others."""
        for process in self._host(host).processes:
            process.is_dead = True
            for session in process.sessions:
                for face in list(session.faces.values()):
                    face.is_open = face.lane.is_open = False
                    self._watch_silence(face.far)
                session.faces.clear()
                self._sessions.pop(session, None)

    def stop(self, process: Process) -> None:
        """Stop a process, as SIGSTOP does."""
        process.is_stopped = True
        for session in process.sessions:
            for face in list(session.faces.values()):
                self._watch_silence(face.far)

    def go_on(self, process: Process) -> None:
        """Let a stopped process go on."""
        process.go_on()
        for session in process.sessions:
            self._meet_others(session, _MEETS_AGAIN_WITHIN_S)

    def _end(self, process: Process) -> None:
        if process.is_dead:
            return
        process.is_dead = True
        for session in process.sessions:
            for face in list(session.faces.values()):
                far = face.far
                face.is_open = False
                face.lane.send(partial(far.session.process.receive, partial(self.lose, far)))
            session.faces.clear()
            self._sessions.pop(session, None)

    # Paths

    def path(
        self,
        one: Host | str,
        other: Host | str,
        *,
        delay_s: float = 0.0002,
        jitter_s: float = 0.0001,
        loss: float = 0.0,
        bytes_a_second: float = 0.0,
    ) -> None:
        """Set how two hosts reach each other, both ways."""
        for ends in self._both(one, other):
            path = self._path(*ends)
            path.delay_s, path.jitter_s, path.loss = delay_s, jitter_s, loss
            path.bytes_a_second = bytes_a_second

    def partition(self, *groups: Iterable[Host | str] | Host | str) -> None:
        """Let nothing pass between the groups; hosts of no group are one more."""
        sides: dict[Host, int] = {}
        for number, group in enumerate(groups, 1):
            for host in [group] if isinstance(group, Host | str) else group:
                sides[self._host(host)] = number
        for one in self._hosts.values():
            for other in self._hosts.values():
                if sides.get(one, 0) != sides.get(other, 0):
                    self._set_up(one, other, False)

    def cut(self, one: Host | str, other: Host | str, *, both_ways: bool = True) -> None:
        """Let nothing pass from one host to another, or both ways."""
        self._set_up(self._host(one), self._host(other), False)
        if both_ways:
            self._set_up(self._host(other), self._host(one), False)

    def heal(self) -> None:
        """Let everything pass again."""
        for one in self._hosts.values():
            for other in self._hosts.values():
                self._set_up(one, other, True)

    def _set_up(self, one: Host, other: Host, is_up: bool) -> None:
        path = self._path(one, other)
        if one is other or path.is_up == is_up:
            return
        path.is_up = is_up
        if not is_up:
            path.changed_ns = self.tasks.now_ns
        for session in self._sessions_of(one):
            for face in list(session.faces.values()):
                if face.far.session.process.host is other:
                    if is_up:
                        face.lane.release()
                    else:
                        self._watch_silence(face.far)
            if is_up:
                self._meet_others(session, _MEETS_AGAIN_WITHIN_S)

    def _path(self, one: Host, other: Host) -> Path:
        path = self._paths.get((one, other))
        if path is None:
            path = self._paths[one, other] = (
                Path(0.00005, 0.00005) if one is other else Path(**vars(self._default))
            )
        return path

    def _both(self, one: Host | str, other: Host | str) -> tuple[tuple[Host, Host], ...]:
        first, second = self._host(one), self._host(other)
        return (first, second), (second, first)

    def _host(self, host: Host | str) -> Host:
        return host if isinstance(host, Host) else self._hosts[host]

    def _sessions_of(self, host: Host) -> list[ZenohSession]:
        return [session for session in self._sessions if session.process.host is host]

    # Sessions and their links

    def declare_advanced_publisher(self, *args: Any, **options: Any) -> Any:
        """As Zenoh's extension."""
        return retained.declare_advanced_publisher(*args, **options)

    def declare_advanced_subscriber(self, *args: Any, **options: Any) -> Any:
        """As Zenoh's extension."""
        return retained.declare_advanced_subscriber(*args, **options)

    def new_cancellation(self) -> Cancellation:
        """As Zenoh's CancellationToken."""
        return Cancellation()

    def open_session(self, settings: Any) -> ZenohSession:
        """Open a session in the process whose turn it is, as `zenoh.open`."""
        process: Process = self.tasks.current.place  # type: ignore[assignment]
        session = ZenohSession(
            self,
            process,
            mode=settings.mode or "peer",
            namespace=settings.namespace,
            zid=f"a{process.urandom(15).hex()}",
            connect=tuple(settings.connect),
            listen=tuple(settings.listen),
        )
        process.sessions.append(session)
        self._sessions[session] = None
        self._meet_others(session, _MEETS_WITHIN_S)
        deadline_ns = self.tasks.now_ns + round(_OPENS_ALONE_S * 1e9)
        while not session.faces and self.tasks.now_ns < deadline_ns:
            self.tasks.wait("others on the network", 0.02)
        if session.mode == "client" and not session.faces:
            self._sessions.pop(session, None)
            raise zenoh.ZError("Unable to connect to any of the routers")
        return session

    def forget(self, session: ZenohSession) -> None:
        """A session has closed."""
        self._sessions.pop(session, None)

    def loses_declaration(self) -> bool:
        """Whether a declaration of a queryable is lost now."""
        return bool(self.lost_declarations) and (
            self.tasks.random.random() < self.lost_declarations
        )

    def round_trip_s(self, session: ZenohSession) -> float:
        """How long the farthest of its links takes to answer."""
        paths = [self._path(session.process.host, far.process.host) for far in session.faces]
        return 2 * max((path.delay_s + path.jitter_s for path in paths), default=0.0)

    def _meet_others(self, session: ZenohSession, within_s: float) -> None:
        for other in list(self._sessions):
            if other is not session and _meet(session, other):
                self._meet_soon(session, other, within_s)

    def _meet_soon(self, one: ZenohSession, other: ZenohSession, within_s: float) -> None:
        pair = (one, other) if one.zid_text > other.zid_text else (other, one)
        if pair in self._meeting or other in one.faces:
            return
        self._meeting.add(pair)

        def try_it() -> None:
            self._meeting.discard(pair)
            if all(session in self._sessions for session in pair) and pair[1] not in pair[0].faces:
                if self._can_talk(*pair):
                    self._link(*pair)
                elif all(not session.process.is_dead for session in pair):
                    # Scouting goes on. Where nothing passes, healing begins it again.
                    pass

        self.tasks.call_after(self.tasks.random.uniform(0.001, within_s), try_it)

    def _can_talk(self, one: ZenohSession, other: ZenohSession) -> bool:
        hosts = one.process.host, other.process.host
        are_up = self._path(*hosts).is_up and self._path(*reversed(hosts)).is_up
        return are_up and one.process.is_running and other.process.is_running

    def _link(self, one: ZenohSession, other: ZenohSession) -> None:
        faces = []
        for near, far in ((one, other), (other, one)):
            path = self._path(near.process.host, far.process.host)
            faces.append(Face(near, Lane(self.tasks, path)))
        faces[0].far, faces[1].far = faces[1], faces[0]
        Link(self.tasks, (faces[0], faces[1]))
        for face in faces:
            stale = face.session.faces.get(face.far.session)
            if stale is not None:
                self.close_face(stale)
        for face in faces:
            face.session.greet(face)

    def close_face(self, face: Face) -> None:
        """This end of a link is closed; what was sent before still arrives."""
        if face.is_open:
            face.is_open = False
            face.session.part(face)

    def lose(self, face: Face) -> None:
        """This end learns that its link is lost; both sides meet again if they can."""
        if not face.is_open:
            return
        self.close_face(face)
        face.lane.is_open = False
        far = face.far
        if far.is_open:
            # Its connection is closed: it learns that as soon as anything passes.
            self._watch_silence(far, 0.0)
        one, other = face.session, far.session
        if one in self._sessions and other in self._sessions:
            self._meet_soon(one, other, _MEETS_AGAIN_WITHIN_S)

    def _watch_silence(self, face: Face, after_s: float = LEASE_S) -> None:
        """Lose the link of a face that has heard nothing for the lease."""

        def look() -> None:
            if not face.is_open or face.session.process.is_dead:
                return
            far = face.far
            path = self._path(far.session.process.host, face.session.process.host)
            quiet_ns = self.tasks.now_ns - path.changed_ns
            is_silent = not far.is_open or not far.session.process.is_running
            if is_silent or (not path.is_up and quiet_ns >= round(after_s * 1e9)):
                face.session.process.receive(lambda: self.lose(face))

        delay_s = max(
            after_s, self._path(face.far.session.process.host, face.session.process.host).delay_s
        )
        self.tasks.call_after(delay_s, look)

    # Running

    def run(
        self,
        seconds: float | None = None,
        *,
        until: Callable[[], object] | None = None,
        timeout_s: float = 60.0,
    ) -> float:
        """Let the network run for this many of its seconds, or until a condition holds.

        Returns the seconds that have passed. Raises SimulationError where the condition does not
        hold after `timeout_s`.
        """
        begun_ns = self.tasks.now_ns
        if until is None:
            self.tasks.wait("the end of a run", 0.0 if seconds is None else seconds)
        else:
            end_ns = begun_ns + round((timeout_s if seconds is None else seconds) * 1e9)
            while not until():
                if self.tasks.now_ns >= end_ns:
                    waited_s = (end_ns - begun_ns) / 1e9
                    raise SimulationError(
                        f"the condition does not hold after {waited_s:g} s (seed {self.seed})"
                    )
                self.tasks.wait("a condition of the test", _LOOK_EVERY_S)
        return (self.tasks.now_ns - begun_ns) / 1e9

    @property
    def now_ns(self) -> int:
        """The true time, in nanoseconds since the Unix epoch; hosts have clocks of their own."""
        return START_NS + self.tasks.now_ns


def _meet(one: ZenohSession, other: ZenohSession) -> bool:
    """Whether two sessions look for each other."""
    modes = {one.mode, other.mode}
    if "client" in modes:
        return "router" in modes
    return True


class _Driver:
    """Where the test itself runs, before it is in any process."""

    name = "test"
    is_stopped = False
    is_dead = False

    def __init__(self) -> None:
        self.parked: list[Task] = []
