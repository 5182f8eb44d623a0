"""The page that `tfbus view` serves: a scene and a panel, kept up to date by `run`."""

import logging
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from tfbus.base.addresses import names_to_open, names_to_open_elsewhere
from tfbus.base.clock import SYSTEM_CLOCK, Clock
from tfbus.base.log import LogOnce
from tfbus.base.signals import held_signals
from tfbus.base.wording import printable
from tfbus.buffer.buffer import Buffer
from tfbus.frames.moment import BusMoment
from tfbus.view.data.picked import PickedPoint
from tfbus.view.data.topics import DataSource, ToolPublishers
from tfbus.view.frames import Floats, Frames, Placed, frames_of, place, trail
from tfbus.view.panels.data import DataPanel
from tfbus.view.panels.panel import Panel
from tfbus.view.panels.pointing import Pointing
from tfbus.view.replay import Replay
from tfbus.view.robots import GivenRobots, RobotSource
from tfbus.view.scene.camera import (
    Cameras,
    Ray,
    around,
    region_of,
    region_of_points,
    with_points,
)
from tfbus.view.scene.data import DataScenes
from tfbus.view.scene.drawn import FIXED_NODE, Drawn, Guest, Region, place_of
from tfbus.view.scene.robots import RobotScenes
from tfbus.view.scene.scene import DataExtent, FrameLabels, Scene, SelectedMarks
from tfbus.view.scene.texts import Texts
from tfbus.view.server import Access, Guard, serve, stop
from tfbus.view.settings import Selections, ViewSettings, ViewState


class PageHost(Protocol):
    """The log and the end of the page; a Node is one."""

    @property
    def log(self) -> logging.Logger:
        """The log for warnings."""

    def wait(self, timeout_s: float | None, *, clock: Clock | None = None) -> bool:
        """Wait, at most until the end of the page; whether it goes on."""


class Moments(Protocol):
    """The bus moment after moment: a listener, a replay, or the buffer of a program."""

    @property
    def buffer(self) -> Buffer:
        """The samples of the last seconds."""

    def moment(self) -> BusMoment:
        """The bus now, or at the cursor."""


# The panel is for reading, and looking at all frames costs more than moving them.
_REFRESH_S = 0.25
_REFRESH_UNWATCHED_S = 1.0
# With thousands of frames a look takes long: the pause after it is at least this many times longer.
_RESTS_PER_LOOK = 8.0

# So long after the cameras have moved the names of frames have found their places.
_NAMES_AFTER_S = 0.5

# The balls around a frame that a camera looks at, or follows, in lengths of its axes.
_FOCUS = 4.0
_FOLLOW = 10.0

# Of messages with more shapes, such as markers, some are enough for the first look.
_FIRST_ITEMS = 200

# A recording is seen from where all of it is in sight, unless that is this many times as far away.
_FARTHEST = 8.0

_BY_DEFAULT = ViewSettings()


@dataclass(frozen=True)
class Serving:
    """The address of the page, how often it moves, and its first settings.

    The settings are saved to `path`. The slider goes back `history_s` seconds. The browser's tab
    has the `title`. With an `access` the page is encrypted, and needs its token. A page that is
    `read_only` sends nothing and saves nothing: it has neither the tabs of guests nor sliders of
    joints. If `is_framed`, pages of other machines may have it in a frame. With `heeds_up_axis`
    meshes are turned by the up axis that they state. `roster` are the robots that are expected.
    Meshes of markers are in packages in the folders of `package_path`, too.
    """

    host: str = "127.0.0.1"
    port: int = 8080
    rate_hz: float = 30.0
    history_s: float = 30.0
    settings: ViewSettings = _BY_DEFAULT
    path: Path = Path("view.yaml")
    title: str = "tfbus"
    access: Access | None = None
    read_only: bool = False
    is_framed: bool = False
    heeds_up_axis: bool = False
    roster: tuple[str, ...] = ()
    package_path: tuple[Path, ...] = ()


@dataclass(frozen=True)
class Choice:
    """The frames to place, by these settings; `unseen` ones have no axes of their own."""

    settings: ViewSettings
    fixed_frame: str = ""
    names: tuple[str, ...] = ()
    unseen: frozenset[str] = frozenset()


class Page:
    """A server of the page, from its construction until `close`.

    It shows the moments of a bus, live or recorded. With a `replay`, which is host and bus then, it
    also moves the recording. `server` is viser's; `frames` are from the last look, and `choice`
    has the frames to place, which have their places in `whole`. Raises ServeError if it cannot
    listen.
    """

    def __init__(
        self,
        host: PageHost,
        bus: Moments,
        serving: Serving,
        robots: RobotSource | None = None,
        guests: Sequence[Guest] = (),
        replay: Replay | None = None,
        data: DataSource | None = None,
        tools: ToolPublishers | None = None,
    ) -> None:
        self._host = host
        self._bus = bus
        self._replay = replay
        self._serving = serving
        self._guests = guests
        self.view = ViewState(serving.settings)
        self._selections = Selections(serving.settings.selected)
        self._log_once = LogOnce(host.log)
        guard = Guard(serving.host, serving.access, serving.is_framed, self._on_refused)
        self.server = serve(serving.host, serving.port, serving.title, guard)
        self.frames = Frames()
        self.choice = Choice(serving.settings)
        self._refresh_at_s = 0.0
        self._now_ns = 0
        self._is_held = False
        self._was_watched = False
        # The frames that are drawn, and these with the frames that only need a place.
        self._placed = self.whole = place(self._buffer, "", (), None)
        self._seen_from = ""
        self._fixed_node = self.server.scene.add_frame(FIXED_NODE, show_axes=False)
        self.cameras = Cameras(self.server)
        self._fixed_at = self.cameras.fixed
        self._names = FrameLabels(self.server, self._selections, self.cameras.window)
        self._selected_marks = SelectedMarks(self.server, self._selections)
        self.robots = RobotScenes(
            self.server.scene,
            robots or GivenRobots(),
            host.log,
            heeds_up_axis=serving.heeds_up_axis,
            package_path=serving.package_path,
        )
        self.drawn = Drawn(self.server.scene)
        named = self.robots.mesh_named
        self.data = DataScenes(self.server, data, host.log, named) if data else None
        self._texts = Texts(self.server)
        self._tools = None if serving.read_only else tools
        self.panel = Panel(
            self.server,
            self.view,
            self._selections,
            self,
            guests,
            lambda: self.is_watched,
            serving.history_s,
            None if serving.read_only else serving.path,
            serving.title,
            self.robots,
            replay,
            serving.roster,
            self.data,
            self._tools,
        )
        self._pointing = Pointing(self.server, self.cameras, self.drawn, self.panel.tools)
        self._scene = Scene(self.server.scene, self._select)
        self._data_extent = DataExtent()

    @property
    def address(self) -> str:
        """The URL of the page on this machine."""
        return self.addresses[0]

    @property
    def port(self) -> int:
        """The port that it listens on."""
        return self.server.get_port()

    @property
    def addresses(self) -> tuple[str, ...]:
        """The URLs that a browser can open: of this machine alone, or of others, too, by its host
        name and its address; with a token that was made for this run.
        """
        host, access = self.server.get_host(), self._serving.access
        names = names_to_open(host) if access is None else names_to_open_elsewhere(host)
        scheme, query = ("http", "") if access is None else ("https", access.query)
        return tuple(
            f"{scheme}://{f'[{name}]' if ':' in name else name}:{self.port}{query}"
            for name in names
        )

    @property
    def is_framed(self) -> bool:
        """Whether pages of other machines may have it in a frame."""
        return self._serving.is_framed

    @property
    def is_watched(self) -> bool:
        """Whether a browser has the page open."""
        return bool(self.server.get_clients())

    def run(self) -> None:
        """Keep the page up to date until the node is shut down, or a signal comes."""
        period_s = 1.0 / self._serving.rate_hz
        due_s = time.monotonic()
        # A KeyboardInterrupt in the midst of viser leaves a coroutine without its await.
        with held_signals() as signals:
            # Browsers are watched in real time, also while a simulated time stands still.
            while (
                self._host.wait(max(0.0, due_s - time.monotonic()), clock=SYSTEM_CLOCK)
                and not signals.consume()
            ):
                due_s = max(due_s + period_s, time.monotonic())
                if not self._is_held:
                    self._try_step()

    def hold(self) -> str:
        """Let all browsers see everything that is there now, and leave the page so. Returns the
        title of the tab that has images which are nowhere else, "" for none.
        """
        if self.data:
            self.data.hold()
        if not self.view.settings.follow:
            self.cameras.refit(self._region_of_all())
        # The names of frames take their places when the cameras have.
        time.sleep(_NAMES_AFTER_S)
        self._is_held = True
        return DataPanel.title if self.data and self.data.has_pictures_without_camera else ""

    def _try_step(self) -> None:
        # As of a callback: a moment that cannot be drawn may be followed by one that can.
        try:
            self.step()
        except Exception as error:
            kind = type(error), str(error)
            self._log_once.exception(kind, "Could not bring the page up to date")
            self._refresh_at_s = time.monotonic() + _REFRESH_UNWATCHED_S

    def step(self, *, at_once: bool = False) -> None:
        """Look at the frames if that is due, or at once, and draw them if a browser watches."""
        now_s = time.monotonic()
        is_watched = self.is_watched
        playback, settings = self.view.playback, self.view.settings
        is_due = at_once or now_s >= self._refresh_at_s or is_watched > self._was_watched
        if self._replay and self._replay.move(
            now_s, is_watched=is_watched, trail_s=settings.trail_s if settings.trails else 0.0
        ):
            is_due = True
        self._was_watched = is_watched
        if self.robots.look(settings) or (is_watched and self.robots.take_meshes()):
            is_due = True
        if is_due:
            self.frames = self._look(settings)
        if is_due or settings is not self.choice.settings:
            self.choice = self._choose(settings)
            if self.data:
                self.data.see(
                    self._buffer,
                    self.choice.fixed_frame,
                    settings,
                    is_held=not playback.follows,
                    is_watched=is_watched,
                )
        if not is_watched and not is_due:
            return
        choice, stamp_ns = self.choice, playback.stamp_ns
        whole = place(self._buffer, choice.fixed_frame, choice.names, stamp_ns)
        self.whole = whole
        self._placed = placed = whole.without(choice.unseen)
        self._selections.keep(self.server.get_clients())
        with self.server.atomic():
            self._draw(placed, whole, choice, stamp_ns)
            self._point(choice.fixed_frame)
            if is_due:
                data = self.data.points(_FIRST_ITEMS) if self.data else np.zeros((0, 3))
                self._data_extent.see(data, settings.drawn)
                self._look_first(placed, whole, data)
                self.panel.refresh(
                    self.frames, whole, choice.fixed_frame, self._buffer, self._now_ns
                )
        shown = [self.frames[name] for name in placed.names] if is_due else None
        self._names.draw(shown, placed, settings, self._scene.size_m, self.cameras.fixed)
        if self.data:
            self._texts.draw(self.data.texts(), self.cameras.fixed)
        # Without this the end of a movement would wait for the next one.
        self.server.flush()
        if is_due:
            end_s = time.monotonic()
            rest_s = _REFRESH_S if is_watched else _REFRESH_UNWATCHED_S
            self._refresh_at_s = max(now_s + rest_s, end_s + _RESTS_PER_LOOK * (end_s - now_s))

    def close(self) -> None:
        """Stop serving. Twice is fine."""
        self.robots.close()
        if self.data:
            self.data.close()
        if self._tools:
            self._tools.close()
        stop(self.server)

    def _on_refused(self, reason: str) -> None:
        self._log_once.warning(reason, "Refused a browser: %s", printable(reason, 300))

    @property
    def _buffer(self) -> Buffer:
        return self._bus.buffer

    def _look(self, settings: ViewSettings) -> Frames:
        before = settings.fixed_frame or self.frames.natural_fixed_frame()
        moment = self._bus.moment()
        self._now_ns = moment.now_ns
        self.panel.fleet.refresh(moment)
        return frames_of(moment, self._buffer, before)

    def _choose(self, settings: ViewSettings) -> Choice:
        frames = self.frames
        fixed_frame = settings.fixed_frame or frames.natural_fixed_frame()
        # Axes would hide the links of a robot; selected ones or ones in conflict have some.
        covered = {
            name
            for name in self.robots.covered - self._selections.chosen
            if name in frames and frames[name].state != "conflict"
        }
        shown = [
            name
            for name in frames.tree_of(fixed_frame)
            if settings.shows(name) and name not in covered
        ]
        # Links and guests are drawn whether or not the axes of their frames are.
        others = {
            *self.robots.frames,
            *covered,
            *self.drawn.frames,
            *(name for each in self._guests for name in each.frames),
            settings.follow,
        }
        unseen = frozenset(name for name in others - set(shown) if name in frames)
        return Choice(settings, fixed_frame, (*shown, *unseen), unseen)

    def _draw(self, placed: Placed, whole: Placed, choice: Choice, stamp_ns: int | None) -> None:
        settings, fixed_frame = choice.settings, choice.fixed_frame
        end_ns = self.panel.newest_ns if stamp_ns is None else stamp_ns
        paths: list[Floats] = []
        for name in settings.trails:
            if name in whole.index and settings.shows(name):
                path = trail(self._buffer, fixed_frame, name, end_ns, settings.trail_s)
                if len(path) > 1:
                    paths.append(path)
        self.robots.draw(whole, self.frames)
        for guest in self._guests:
            guest.draw(whole, fixed_frame)
        regions = [guest.region for guest in self._guests]
        around_m = max((region.radius_m for region in regions if region), default=0.0)
        points = self.robots.points(whole, self.frames)
        if len(points):
            around_m = max(around_m, float(np.ptp(points, axis=0).max()))
        self._scene.fit(placed, settings, around_m, self._data_extent.m)
        self._keep_sight(fixed_frame, stamp_ns)
        self._follow(settings)
        fixed = self.cameras.fixed
        self.drawn.draw(whole, fixed)
        in_scene = placed.moved(fixed)
        self._scene.draw(self.frames, in_scene, list(map(fixed.apply, paths)), settings)
        self._selected_marks.draw(self.frames, in_scene, self._scene.size_m)

    # The cameras

    def _look_first(self, placed: Placed, whole: Placed, data: Floats) -> None:
        """Let browsers see the first frames and points (N, 3) of messages; `whole` also has the
        frames without axes.
        """
        # Most frames of a recording come right after its beginning, where it waits for a browser.
        if self._replay and not self._was_watched:
            return
        region = self._guests_region()
        with_robots = self._region_with_robots(placed, whole)
        if region or with_robots or len(placed.names) >= 2 or len(data):
            later = self._region_later(placed)
            has_more = any(found is not None for found in (region, with_robots, later))
            shown = region or with_points(later or with_robots or region_of(placed), data)
            topics = len(self.data.ever_drawn) if self.data else 0
            built = (topics, *self.robots.built(whole, self.frames))
            self.cameras.aim(shown, has_more, len(whole.names), built)

    def _region_with_robots(self, placed: Placed, whole: Placed) -> Region | None:
        """The ball around frames and robots; None without a robot that has a place."""
        points = self.robots.points(whole, self.frames)
        if not len(points):
            return None
        return region_of_points(np.concatenate((placed.xyz, points)))

    def _region_later(self, placed: Placed) -> Region | None:
        """The poses of the frames of a playing recording, now and later; None if it is held, or
        if that is so large that they would be lost in it.
        """
        if not self._replay or not self._replay.samples:
            return None
        if self._replay.playhead.progress.is_paused:
            return None
        whole = now = region_of(placed)
        for buffer in self._replay.samples:
            later = place(buffer, self.choice.fixed_frame, self.choice.names, None)
            if later.names:
                whole = around(whole, region_of(later))
        return whole if whole.radius_m < _FARTHEST * now.radius_m else None

    def _guests_region(self) -> Region | None:
        return next((found for guest in self._guests if (found := guest.region)), None)

    def _keep_sight(self, fixed_frame: str, stamp_ns: int | None) -> None:
        """Let browsers keep their view, after a change of the fixed frame."""
        before = self._seen_from
        # A fixed frame that does not exist yet shows nothing.
        if before == fixed_frame or not self.whole.names:
            return
        self._seen_from = fixed_frame
        if not before:
            return
        found = place(self._buffer, fixed_frame, (before,), stamp_ns)
        if found.names:
            self.cameras.carry(found.pose(0))
        else:
            self.cameras.refit(self._region_of_all())

    def _follow(self, settings: ViewSettings) -> None:
        """Let the cameras move with the frame that they follow."""
        row = self.whole.index.get(settings.follow)
        pose = None if row is None else self.whole.pose(row)
        radius_m = _FOLLOW * self._scene.size_m
        self.cameras.follow(settings.follow, pose, radius_m, turns=settings.follow_yaw)
        if self.cameras.fixed != self._fixed_at:
            self._fixed_at = self.cameras.fixed
            put = place_of(self._fixed_at)
            self._fixed_node.position, self._fixed_node.wxyz = put["position"], put["wxyz"]

    # The tools

    def _point(self, fixed_frame: str) -> None:
        """Use the aims of browsers."""
        aimed_in = fixed_frame if self.whole.names else ""
        size_m = self._scene.size_m
        self._pointing.use(aimed_in, size_m, self._way_to_what_is_drawn, self._point_met_by)

    def _point_met_by(self, ray: Ray) -> PickedPoint | None:
        return self.data.point_met_by(ray, self.choice.fixed_frame) if self.data else None

    def _way_to_what_is_drawn(self, ray: Ray) -> float:
        """The way in m to the first message or robot in a ray of the fixed frame."""
        ways = [self.robots.met_by(ray, self.whole, self.frames)]
        if self.data:
            ways.append(self.data.met_by(ray))
        return min(ways)

    def show_all(self, client: int) -> None:
        """Let a browser see all that is drawn: frames, robots, messages, and shapes of guests."""
        self.cameras.show(client, self._region_of_all())

    def _region_of_all(self) -> Region:
        region = self._guests_region()
        if region is not None and not (self._placed.names or self.robots.robots):
            return region
        found = self._region_with_robots(self._placed, self.whole) or region_of(self._placed)
        data = self.data.points() if self.data else None
        if data is not None and len(data):
            found = around(found, region_of_points(data))
        return around(found, region) if region else found

    def show_from_above(self, client: int) -> None:
        """Let a browser see all that is drawn, from straight above."""
        self.cameras.show_from_above(client, self._region_of_all())

    def focus(self, client: int) -> str:
        """Let a browser look at the frame that it has selected; why it cannot, "" if it can."""
        name = self._selections.of(client)
        if not name:
            return "Click on a frame first, in the tree or in the scene."
        fixed_frame, stamp_ns = self.choice.fixed_frame, self.view.playback.stamp_ns
        found = place(self._buffer, fixed_frame, (name,), stamp_ns)
        if not found.names:
            return f"{printable(name)} has no place: {printable(found.missing[name])}"
        self.cameras.focus(client, Region(found.xyz[0], _FOCUS * self._scene.size_m))
        return ""

    def _select(self, client: int, name: str) -> None:
        if name:
            self._selections.select(client, name)
