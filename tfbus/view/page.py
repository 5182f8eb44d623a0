"""The page that `tfbus view` serves: a scene and a panel, kept up to date by `run`."""

import contextlib
import io
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from tfbus import Buffer, Node, SystemClock, TransformListener
from tfbus.nodes.turtle import field
from tfbus.nodes.turtle.view.scene import WORLD, TurtleScene
from tfbus.nodes.turtle.view.turtles import Turtles
from tfbus.view.model.frames import Frames, FrameWatch
from tfbus.view.model.placement import Floats, Placed, place, trail
from tfbus.view.model.settings import ViewSettings
from tfbus.view.model.urdf import Visual
from tfbus.view.model.view_state import Desk
from tfbus.view.panels.panel import Panel
from tfbus.view.scene.camera import FirstLook
from tfbus.view.scene.labels import Names
from tfbus.view.scene.robot import RobotScene
from tfbus.view.scene.scene import Scene
from tfbus.view.server import serve

# The panel is read by people, and looking at all frames costs more than moving them.
_REFRESH_S = 0.25
_REFRESH_UNWATCHED_S = 1.0
# With thousands of frames a look takes long: so many times as long it rests after one.
_RESTS_PER_LOOK = 8.0

_BY_DEFAULT = ViewSettings()

# Of a ball around what is seen of the field.
_FIELD_RADIUS_M = 0.68 * field.SIZE_M


@dataclass(frozen=True)
class Serving:
    """Where the page is served, how often it moves, and which settings it begins with.

    The settings are saved to `path`. `history_s` is how far back the slider goes.
    """

    host: str = "127.0.0.1"
    port: int = 8080
    rate_hz: float = 30.0
    history_s: float = 30.0
    settings: ViewSettings = _BY_DEFAULT
    path: Path = Path("view.yaml")


@dataclass(frozen=True)
class _Wanted:
    """The frames to be placed, by these settings; those `unseen` have no axes of their own."""

    settings: ViewSettings
    fixed_frame: str = ""
    names: tuple[str, ...] = ()
    unseen: frozenset[str] = frozenset()


class Page:
    """A server of the page, from its construction until `close`.

    Raises ServeError where it cannot listen.
    """

    def __init__(
        self,
        node: Node,
        buffer: Buffer,
        listener: TransformListener,
        serving: Serving,
        robot: Sequence[Visual] = (),
    ) -> None:
        self._node = node
        self._buffer = buffer
        self._listener = listener
        self._serving = serving
        self.desk = Desk(serving.settings)
        self._server = serve(serving.host, serving.port)
        self._watch = FrameWatch(buffer)
        self._frames = Frames()
        self._wanted = _Wanted(serving.settings)
        self._refresh_at_s = 0.0
        self._is_held = False
        self._was_watched = False
        self._first_look = FirstLook(self._server)
        self._names = Names(self._server)
        scene = self._server.scene
        self._turtles = turtles = Turtles(node, lambda: self.is_watched)
        self._robot_scene = RobotScene(scene, robot, node.log)
        self._panel = Panel(
            self._server.gui,
            self.desk,
            turtles,
            serving.history_s,
            serving.path,
            self._robot_scene.mistakes,
        )
        self._scene = Scene(scene, self._select)
        self._turtle_scene = TurtleScene(scene, turtles)

    @property
    def address(self) -> str:
        """The URL of the page."""
        host = self._server.get_host()
        shown = f"[{host}]" if ":" in host else host
        return f"http://{shown}:{self._server.get_port()}"

    @property
    def is_watched(self) -> bool:
        """Whether a browser has the page open."""
        return bool(self._server.get_clients())

    def run(self) -> None:
        """Keep the page up to date until the node is shut down."""
        period_s = 1.0 / self._serving.rate_hz
        due_s = time.monotonic()
        # Whoever watches does so in real time, also while a simulated one stands still.
        clock = SystemClock()
        while self._node.wait(max(0.0, due_s - time.monotonic()), clock=clock):
            due_s = max(due_s + period_s, time.monotonic())
            if not self._is_held:
                self.step()

    def hold(self) -> None:
        """Let the page be as it is from now on."""
        self._is_held = True

    def step(self) -> None:
        """Look at the frames, where it is time, and draw them, where somebody watches."""
        now_s = time.monotonic()
        is_watched = self.is_watched
        is_due = now_s >= self._refresh_at_s or is_watched > self._was_watched
        self._was_watched = is_watched
        playback, settings = self.desk.playback, self.desk.settings
        if is_due:
            self._frames = self._look(settings)
        if is_due or settings is not self._wanted.settings:
            self._wanted = self._choose(settings)
        if not is_watched and not is_due:
            return
        wanted, stamp_ns = self._wanted, playback.stamp_ns
        around = place(self._buffer, wanted.fixed_frame, wanted.names, stamp_ns)
        placed = around.without(wanted.unseen)
        with self._server.atomic():
            self._draw(placed, around, wanted, stamp_ns)
            if is_due:
                self._look_first(placed)
                now_ns = self._node.now_ns()
                self._panel.refresh(self._frames, placed, wanted.fixed_frame, self._buffer, now_ns)
        states = [self._frames.states[name] for name in placed.names] if is_due else None
        self._names.draw(states, placed, settings, self._scene.size_m)
        # Else the last of a movement would wait for the next one.
        self._server.flush()
        if is_due:
            end_s = time.monotonic()
            rest_s = _REFRESH_S if is_watched else _REFRESH_UNWATCHED_S
            self._refresh_at_s = max(now_s + rest_s, end_s + _RESTS_PER_LOOK * (end_s - now_s))

    def close(self) -> None:
        """Stop serving. Twice is fine."""
        # viser says so on standard output, where nobody has asked for it.
        with contextlib.redirect_stdout(io.StringIO()):
            self._server.stop()

    def _look(self, settings: ViewSettings) -> Frames:
        sent = {info.name: info.frames for info in self._listener.streams() if info.alive}
        before = settings.fixed_frame or self._frames.natural_fixed_frame()
        return self._watch.look(sent, before)

    def _choose(self, settings: ViewSettings) -> "_Wanted":
        frames = self._frames
        fixed_frame = settings.fixed_frame or frames.natural_fixed_frame()
        shown = [name for name in frames.tree_of(fixed_frame) if settings.shows(name)]
        # The field and a robot's links are there whether or not the axes of their frames are.
        others = {WORLD, *self._robot_scene.links, *self._turtles.names} - set(shown)
        unseen = frozenset(name for name in others if name in frames)
        return _Wanted(settings, fixed_frame, (*shown, *unseen), unseen)

    def _draw(
        self, placed: Placed, around: Placed, wanted: "_Wanted", stamp_ns: int | None
    ) -> None:
        settings, fixed_frame = wanted.settings, wanted.fixed_frame
        end_ns = self._panel.newest_ns if stamp_ns is None else stamp_ns
        trails: dict[str, Floats] = {}
        for name in settings.trails:
            if name in placed.index:
                path = trail(self._buffer, fixed_frame, name, end_ns, settings.trail_s)
                if len(path) > 1:
                    trails[name] = path
        self._robot_scene.draw(around)
        self._turtle_scene.draw(around, fixed_frame)
        around_m = _FIELD_RADIUS_M if self._turtle_scene.is_shown else 0.0
        self._scene.draw(self._frames, placed, trails, settings, around_m)

    def _look_first(self, placed: Placed) -> None:
        if self._turtle_scene.is_shown:
            middle, radius_m = self._turtle_scene.middle, _FIELD_RADIUS_M
        elif len(placed.names) >= 2:
            middle = (placed.xyz.min(axis=0) + placed.xyz.max(axis=0)) / 2.0
            radius_m = 0.85 * max(placed.extent_m(), 1.0)
        else:
            return
        self._first_look.aim(middle, radius_m, self._turtle_scene.is_shown, len(placed.names))

    def _select(self, name: str) -> None:
        if name:
            self.desk.change(selected=name)
