"""The page for a buffer of this program, or a recording, and with the program's own drawings."""

import atexit
import logging
import math
import threading
from dataclasses import replace
from html import escape
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tfbus.base.addresses import is_local
from tfbus.base.clock import SYSTEM_CLOCK, Clock
from tfbus.base.errors import InvalidArgumentException, TfbusError
from tfbus.base.installation import install_command
from tfbus.buffer.buffer import Buffer
from tfbus.command.server_access import AccessToken, made_tls
from tfbus.frames.moment import BusMoment
from tfbus.frames.recording import Recording
from tfbus.frames.snapshot import frame_tree
from tfbus.geometry.transform import Transform, check_frame_id
from tfbus.recording.reader import RecordingReader
from tfbus.robot.robot import Robot
from tfbus.view.settings import ViewSettings

_missing: ImportError | None = None
try:
    from tfbus.view.page import Page, Serving
    from tfbus.view.replay import Replay
    from tfbus.view.robots import GivenRobots, RecordedRobots, ShownRobot
    from tfbus.view.scene.drawn import (
        color_of,
        image_of,
        length_of,
        place_of,
        point_of,
        points_of,
        scale_of_depth,
    )
    from tfbus.view.server import Access
except ImportError as error:  # `show` raises it
    _missing = error

_ORANGE = (230, 120, 20)
_GREY = (90, 90, 100)

# The slider goes back as far as the buffer does when the page opens, within these limits.
_LEAST_HISTORY_S = 30.0
_MOST_HISTORY_S = 3600.0

_END_S = 5.0


class ShownBuffer:
    """The host of the page: its time is the newest sample's, so that a recording is fresh."""

    def __init__(self, buffer: Buffer) -> None:
        self.log = logging.getLogger("tfbus.view")
        self.buffer = buffer
        self._ended = threading.Event()

    def now_ns(self) -> int:
        newest = [
            frame.newest_ns
            for frame in self.buffer.all_frames()
            if frame.newest_ns is not None and not frame.static
        ]
        return max(newest, default=0) or self.buffer.clock()

    def wait(self, timeout_s: float | None, *, clock: Clock | None = None) -> bool:
        return not self._ended.wait(timeout_s)

    def end(self) -> None:
        self._ended.set()

    def close(self) -> None:
        pass

    def moment(self) -> BusMoment:
        tree = frame_tree(self.buffer, (), self.now_ns())
        return BusMoment(at_ns=SYSTEM_CLOCK.now_ns(), tree=tree)


class View:
    """A page with the frames of a buffer, from `show` until `close()` or the end of its `with`.

    Each `add_` draws a shape by a name, in the axes of a frame, with which it moves; a shape of the
    same name is replaced. `pose` is a Transform, or a point (3,), in the frame. Lengths are metres,
    colours red, green and blue from 0 to 255. Safe from any thread. Raises InvalidArgumentException
    for wrong names, shapes and numbers.
    """

    def __init__(
        self, page: "Page", program: "ShownBuffer | Replay", robots: "GivenRobots | RecordedRobots"
    ) -> None:
        self._page = page
        self._robots = robots
        self._program = program
        self._thread = threading.Thread(target=self._run, name="tfbus view", daemon=True)
        self._thread.start()
        # Before viser's own, which says on standard output that it stops.
        atexit.register(self.close)

    @property
    def url(self) -> str:
        """The address of the page."""
        return self._page.address

    @property
    def is_watched(self) -> bool:
        """Whether a browser has the page open."""
        return self._page.is_watched

    # A recording

    @property
    def at_ns(self) -> int:
        """The log time that the page of a recording shows, in nanoseconds since the Unix epoch."""
        return self._replay().playhead.progress.log_ns

    def seek(self, at_ns: int) -> None:
        """Show a recording at a log time, or at its end that is nearer."""
        self._replay().playhead.seek(at_ns)

    def play(self, speed: float | None = None) -> None:
        """Play a recording while a browser shows it, `speed` (0.001 to 10,000) times as fast; at
        its end from the beginning. Raises InvalidArgumentException for another speed.
        """
        playhead = self._replay().playhead
        if speed is not None:
            playhead.set_rate(speed)
        playhead.resume()

    def pause(self) -> None:
        """Hold a recording where it is."""
        self._replay().playhead.pause()

    def _replay(self) -> "Replay":
        if isinstance(self._program, ShownBuffer):
            raise InvalidArgumentException("the view follows a buffer; only a recording is played")
        return self._program

    # Drawing

    def add_points(
        self,
        name: str,
        frame: str,
        points: ArrayLike,
        *,
        color: ArrayLike = _ORANGE,
        size_m: float = 0.03,
    ) -> None:
        """Draw points (N, 3); `color` is one, or one for each (N, 3).

        Points that are not finite, as scans have them where nothing is, are left out.
        """
        xyz = points_of(points)
        finite = np.isfinite(xyz).all(axis=1)
        colors = color_of(color, len(xyz))
        colors = colors[finite] if colors.ndim == 2 else colors
        size = length_of(size_m, "size_m")
        self._add(
            name,
            frame,
            lambda scene, path: scene.add_point_cloud(
                path,
                xyz[finite].astype(np.float32),
                colors,
                point_size=size,
                point_shape="circle",
                precision="float32",
            ),
        )

    def add_lines(
        self,
        name: str,
        frame: str,
        points: ArrayLike,
        *,
        color: ArrayLike = _ORANGE,
        width_m: float = 0.01,
    ) -> None:
        """Draw a line along points (N, 3), or N separate lines (N, 2, 3)."""
        array = np.asarray(points, dtype=np.float64)
        if array.ndim != 3 or array.shape[1:] != (2, 3):
            along = points_of(array)
            array = np.stack((along[:-1], along[1:]), axis=1)
        if not np.isfinite(array).all():
            raise InvalidArgumentException("points: a line needs finite points")
        width, colors = length_of(width_m, "width_m"), color_of(color)
        self._add(
            name,
            frame,
            lambda scene, path: scene.add_line_segments(
                path, array.astype(np.float32), colors, thickness=width
            ),
        )

    def add_arrow(
        self,
        name: str,
        frame: str,
        start: ArrayLike,
        end: ArrayLike,
        *,
        color: ArrayLike = _ORANGE,
        width_m: float = 0.02,
    ) -> None:
        """Draw an arrow from one point (3,) to another, such as a velocity or a force."""
        ends = np.stack((point_of(start, "start"), point_of(end, "end")))[None]
        width, colors = length_of(width_m, "width_m"), color_of(color)
        head_m = min(4.0 * width, 0.5 * float(np.linalg.norm(ends[0, 1] - ends[0, 0])))
        self._add(
            name,
            frame,
            lambda scene, path: scene.add_arrows(
                path,
                ends.astype(np.float32),
                colors,
                shaft_radius=width / 2.0,
                head_radius=1.5 * width,
                head_length=head_m,
            ),
        )

    def add_box(
        self,
        name: str,
        frame: str,
        size: ArrayLike,
        *,
        pose: Transform | ArrayLike | None = None,
        color: ArrayLike = _GREY,
        opacity: float = 1.0,
    ) -> None:
        """Draw a box with sides `size` (3,) around the origin of the frame, or at `pose`."""
        sides = [length_of(side, "size") for side in point_of(size, "size").tolist()]
        look = {"color": _plain(color_of(color)), "opacity": _opacity(opacity)}
        self._add(
            name,
            frame,
            lambda scene, path: scene.add_box(
                path, dimensions=tuple(sides), **look, **place_of(pose)
            ),
        )

    def add_sphere(
        self,
        name: str,
        frame: str,
        radius_m: float,
        *,
        pose: Transform | ArrayLike | None = None,
        color: ArrayLike = _GREY,
        opacity: float = 1.0,
    ) -> None:
        """Draw a sphere around the origin of the frame, or at `pose`."""
        radius, place = length_of(radius_m, "radius_m"), place_of(pose)
        look = {"color": _plain(color_of(color)), "opacity": _opacity(opacity)}
        self._add(
            name,
            frame,
            lambda scene, path: scene.add_icosphere(
                path, radius=radius, subdivisions=3, **look, **place
            ),
        )

    def add_text(
        self,
        name: str,
        frame: str,
        text: str,
        *,
        pose: Transform | ArrayLike | None = None,
    ) -> None:
        """Write a text that always faces the browser, at the origin of the frame, or at `pose`."""
        check_frame_id(frame, "frame")
        at = place_of(pose).get("position", np.zeros(3))
        self._page.drawn.add_label(name, frame, str(text), at)

    def add_camera(
        self,
        name: str,
        frame: str,
        *,
        fov_y_rad: float | None = None,
        camera_matrix: ArrayLike | None = None,
        size_px: tuple[int, int] | None = None,
        image: ArrayLike | None = None,
        depth_m: float = 0.5,
        color: ArrayLike = _GREY,
    ) -> None:
        """Draw the view of a camera: its frustum, and with `image` the picture in it.

        `frame` is the optical one: z ahead, x to the right, y down. The angle is `fov_y_rad` from
        top to bottom (1.0), or by a `camera_matrix` (3, 3) for pictures of `size_px`, width by
        height. The picture, `depth_m` ahead, is uint8 (H, W, 3), red first, or (H, W).
        """
        picture = None if image is None else image_of(image)
        if size_px is None:
            size_px = (4, 3) if picture is None else (picture.shape[1], picture.shape[0])
        width, height = (length_of(side, "size_px") for side in size_px)
        if camera_matrix is not None:
            if picture is None and size_px == (4, 3):
                raise InvalidArgumentException("a camera_matrix needs size_px, or an image")
            fov_y_rad = _fov_y_rad(camera_matrix, height)
        fov = 1.0 if fov_y_rad is None else float(fov_y_rad)
        if not 0.0 < fov < math.pi:
            raise InvalidArgumentException(f"fov_y_rad must be from 0 to pi, got {fov!r}")
        depth, colors = length_of(depth_m, "depth_m"), _plain(color_of(color))
        self._add(
            name,
            frame,
            lambda scene, path: scene.add_camera_frustum(
                path,
                fov=fov,
                aspect=width / height,
                scale=depth * scale_of_depth(fov, width / height),
                color=colors,
                image=picture,
                thickness=0.02 * depth,
                cast_shadow=False,
                receive_shadow=False,
            ),
        )

    def add_image(
        self,
        name: str,
        frame: str,
        image: ArrayLike,
        width_m: float,
        *,
        pose: Transform | ArrayLike | None = None,
    ) -> None:
        """Draw an image (H, W, 3) or (H, W), uint8, such as a map, in the plane of x (to its right)
        and y (up) around the frame's origin, or at `pose`.
        """
        picture, width = image_of(image), length_of(width_m, "width_m")
        height = width * picture.shape[0] / picture.shape[1]
        # viser's images have y down.
        if pose is None or not isinstance(pose, Transform):
            pose = Transform((0.0, 0.0, 0.0) if pose is None else point_of(pose, "pose"))
        upright = pose @ Transform.from_rpy(math.pi, 0.0, 0.0)
        self._add(
            name,
            frame,
            lambda scene, path: scene.add_image(
                path,
                picture,
                render_width=width,
                render_height=height,
                cast_shadow=False,
                receive_shadow=False,
                **place_of(upright),
            ),
        )

    def add_robot(self, robot: Robot, *, prefix: str = "") -> None:
        """Draw a robot: its links at the frames of their names behind `prefix`, with their meshes.

        While the buffer has none of these frames it stands at the origin, with sliders in the page
        for its joints. A robot of the same name and prefix is replaced.
        """
        if prefix:
            check_frame_id(prefix, "prefix")
        self._robots.add(ShownRobot(robot, prefix))

    def remove(self, name: str) -> None:
        """Remove a shape. Raises InvalidArgumentException if there is none of that name."""
        if not self._page.drawn.remove(name):
            raise InvalidArgumentException(f"there is no shape {name!r} in the view")

    def clear(self) -> None:
        """Remove all shapes."""
        for name in self._page.drawn.shapes:
            self._page.drawn.remove(name)

    # Its life

    def wait(self) -> None:
        """Keep the page until Ctrl-C, at the end of a script."""
        try:
            while self._program.wait(3600.0):
                pass
        except KeyboardInterrupt:
            self.close()

    def close(self) -> None:
        """Stop serving. Twice is fine."""
        atexit.unregister(self.close)
        self._program.end()
        if self._thread is not threading.current_thread():
            self._thread.join(_END_S)
        self._page.close()
        if self._thread is threading.current_thread() or not self._thread.is_alive():
            self._program.close()

    def __enter__(self) -> "View":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"<View at {self.url}>"

    def _repr_html_(self) -> str:
        url = escape(self.url, quote=True)
        link = f'<div><a href="{url}" target="_blank">{url}</a></div>'
        if not self._page.is_framed:
            return link
        return f'<iframe src="{url}" width="100%" height="500" style="border:0"></iframe>{link}'

    def _add(self, name: str, frame: str, make: Any) -> None:
        check_frame_id(frame, "frame")
        scene = self._page.server.scene
        self._page.drawn.add(name, frame, lambda path: make(scene, path))

    def _run(self) -> None:
        try:
            self._page.run()
        except Exception:
            self._program.log.exception("The view at %s has stopped", self.url)


def show(
    buffer: Buffer | Recording,
    *,
    fixed_frame: str = "",
    host: str = "127.0.0.1",
    port: int = 8080,
    rate_hz: float = 30.0,
    history_s: float | None = None,
    at_ns: int | None = None,
    public: bool = False,
) -> View:
    """Show a buffer or a recording in a browser, in three dimensions, at `view.url`.

    The page follows a buffer. A recording it plays from its beginning once a browser has it, or
    holds at the log time `at_ns`.

    In a notebook the page appears below the cell. The port is the first free one from `port` on.
    The slider goes back `history_s` seconds, by default as far as the buffer, from 30 s to an hour.

    For browsers of other machines give a `host` such as 0.0.0.0, and `public=True`: then the page
    is encrypted, and `view.url` has the token.

    Raises TfbusError without the extra `view` (`secure` for a public page), and if it cannot
    listen.
    """
    if not public and not is_local(host):
        raise InvalidArgumentException(
            f"host {host!r} lets all in who reach this machine: add public=True, for a token and "
            "encryption"
        )
    if not 0.0 < rate_hz <= 60.0:
        raise InvalidArgumentException(f"rate_hz must be above 0 and at most 60, got {rate_hz!r}")
    if _missing is not None:
        text = f"viser is not installed ({_missing}): {install_command('view')}"
        raise TfbusError(text) from _missing
    settings = ViewSettings(fixed_frame=fixed_frame)
    access = _access(host) if public else None
    # Notebooks are often served by another machine; nothing on the page moves anything.
    is_framed = access is None
    serving = Serving(
        host, port, rate_hz, history_s or 30.0, settings, access=access, is_framed=is_framed
    )
    if not isinstance(buffer, Buffer):
        return _show_recording(buffer, serving, at_ns)
    if at_ns is not None:
        raise InvalidArgumentException("at_ns is a time of a recording, and this is a buffer")
    program = ShownBuffer(buffer)
    serving = replace(serving, history_s=history_s or _history_s(buffer))
    robots = GivenRobots()
    return View(Page(program, program, serving, robots), program, robots)


def _access(host: str) -> "Access":
    try:
        return Access(AccessToken(), made_tls(host))
    except ImportError as error:
        raise TfbusError(
            f"cryptography is not installed ({error}): {install_command('secure')}"
        ) from error


def _show_recording(recording: Recording, serving: "Serving", at_ns: int | None) -> View:
    # Its own: the program may close the recording, and a reader is for one thread.
    reader = RecordingReader(*recording.paths)
    try:
        first_ns = reader.start_ns if at_ns is None else at_ns
        replay = Replay(reader, at_ns=first_ns, plays=at_ns is None)
        robots = RecordedRobots(reader, replay)
        page = Page(replay, replay, serving, robots, replay=replay)
    except BaseException:
        reader.close()
        raise
    replay.measure_meanwhile()
    return View(page, replay, robots)


def _history_s(buffer: Buffer) -> float:
    spans_ns = [
        frame.newest_ns - frame.oldest_ns
        for frame in buffer.all_frames()
        if frame.newest_ns is not None and frame.oldest_ns is not None
    ]
    return min(max(max(spans_ns, default=0) / 1e9, _LEAST_HISTORY_S), _MOST_HISTORY_S)


def _fov_y_rad(camera_matrix: ArrayLike, height_px: float) -> float:
    matrix = np.asarray(camera_matrix, dtype=np.float64)
    if matrix.shape != (3, 3) or not matrix[1, 1] > 0.0:
        raise InvalidArgumentException(
            f"camera_matrix: expected shape (3, 3) with focal lengths above 0, got {matrix!r}"
        )
    return 2.0 * math.atan(height_px / 2.0 / float(matrix[1, 1]))


def _opacity(opacity: float) -> float | None:
    if not 0.0 < opacity <= 1.0:
        raise InvalidArgumentException(f"opacity must be above 0 and at most 1, got {opacity!r}")
    return None if opacity >= 1.0 else float(opacity)


def _plain(color: Any) -> tuple[int, int, int]:
    r, g, b = color.tolist()
    return r, g, b
