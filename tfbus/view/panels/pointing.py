"""The use of tools on the scene: a place is sent or measured, and marked there."""

import math
from collections.abc import Callable
from html import escape

import numpy as np
import viser

from tfbus.base.wording import printable
from tfbus.geometry.transform import Transform
from tfbus.view.data.picked import PickedPoint
from tfbus.view.data.topics import TOOLS, Tool
from tfbus.view.frames import Floats
from tfbus.view.panels.tools import (
    FINDERS,
    MEASURE,
    SELECT,
    Aim,
    ToolsPanel,
    measured_text,
    picked_html,
    place_text,
    sent_text,
)
from tfbus.view.scene.camera import Cameras, Ray, Viewport
from tfbus.view.scene.drawn import Drawn, place_of, unit_mesh

Place = tuple[float, float, float]

# A mark is so many times as long as axes, and at least this part of the way to it; a shorter drag
# has no heading.
_MARK = 2.0
_MARK_SEEN = 0.08
_LEAST_DRAG_PX = 5.0
_NOTE_S = 4.0

_MEASURED = (20, 120, 200)
_SELECTED = (255, 0, 160)
# The mark of a selected point is so wide in the picture of its browser.
_SELECTED_PX = 10.0

_MARKS = {
    MEASURE: ("measured", "measured from", "measured text"),
    SELECT: ("selected", "selected text"),
}


def mark_size(axes_m: float, way_m: float) -> float:
    """The length in m of a mark that is so far away from the camera, beside axes of this length."""
    return max(_MARK * axes_m, _MARK_SEEN * way_m)


class Pointing:
    """Uses the tools of a panel on the scene.

    A distance begins at the first click of a browser, and ends at its second; all see it.
    """

    def __init__(
        self, server: viser.ViserServer, cameras: Cameras, drawn: Drawn, panel: ToolsPanel
    ) -> None:
        self._server = server
        self._cameras = cameras
        self._drawn = drawn
        self._panel = panel
        self._starts: dict[int, tuple[str, Place]] = {}
        self._met_by: Callable[[Ray], float] = lambda ray: math.inf
        self._point_met_by: Callable[[Ray], PickedPoint | None] = lambda ray: None
        self._axes_m = 0.0

    def use(
        self,
        fixed_frame: str,
        axes_m: float,
        met_by: Callable[[Ray], float],
        point_met_by: Callable[[Ray], PickedPoint | None],
    ) -> None:
        """Use the aims of browsers since the last call, in a fixed frame, "" while there is none.

        `axes_m` is the length of axes, `met_by(ray)` the way in m to shapes of robots and messages,
        `point_met_by(ray)` the first point of a cloud or scan.
        """
        self._axes_m, self._met_by, self._point_met_by = axes_m, met_by, point_met_by
        for tool in self._panel.take_cleared():
            self._unmark(*_MARKS[tool])
            if tool == MEASURE:
                self._starts.clear()
        for aim in self._panel.take():
            window = self._cameras.window(aim.client)
            if window is None:
                continue
            if not fixed_frame:
                why = "There are no frames yet to aim in."
            elif aim.tool == MEASURE:
                why = self._measure(aim, window, fixed_frame)
            elif aim.tool == SELECT:
                why = self._select(window.ray(aim.start), fixed_frame)
            else:
                why = self._send(aim, TOOLS[aim.tool], window, fixed_frame)
            client = self._server.get_clients().get(aim.client)
            if why and client is not None:
                done = FINDERS[aim.tool].done if aim.tool in FINDERS else "sent"
                client.add_notification(f"Nothing was {done}", why, auto_close_seconds=_NOTE_S)

    def _measure(self, aim: Aim, window: Viewport, fixed_frame: str) -> str:
        """Begin to measure, or end it; why it cannot, "" if it can."""
        met = self._met(window.ray(aim.start))
        if met is None:
            return _NO_GROUND
        xyz, way_m = met
        start = self._starts.pop(aim.client, None)
        # A place in another fixed frame is another place.
        if aim.is_first or start is None or start[0] != fixed_frame:
            self._starts[aim.client] = fixed_frame, xyz
            self._unmark("measured", "measured text")
            size_m = 0.25 * mark_size(self._axes_m, way_m)
            self._mark("measured from", fixed_frame, "sphere", _MEASURED, xyz, 0.0, size_m)
            return ""
        text = measured_text(fixed_frame, start[1], xyz)
        self._panel.note_found(MEASURE, f"<b>{escape(text)}</b>")
        ends = np.array([[start[1], xyz]], np.float32)
        middle = (np.array(start[1]) + xyz) / 2.0
        scene = self._server.scene
        self._drawn.add(
            "measured",
            fixed_frame,
            lambda path: scene.add_line_segments(
                path, ends, _MEASURED, thickness=4.0, thickness_units="screen"
            ),
        )
        self._drawn.add_label("measured text", fixed_frame, text, middle)
        return ""

    def _select(self, ray: Ray, fixed_frame: str) -> str:
        """Show a point of a cloud or scan, and mark it; why it cannot, "" if it can."""
        point = self._point_met_by(ray)
        if point is None:
            return "There is no point of a cloud or scan."
        self._panel.note_found(SELECT, picked_html(point))
        xyz = point.places[fixed_frame]
        size_m = _SELECTED_PX * ray.pixel_rad * math.dist(xyz, ray.origin)
        self._mark("selected", fixed_frame, "sphere", _SELECTED, xyz, 0.0, size_m)
        text = f"{printable(point.topic)} {point.index}: {place_text(xyz)}"
        above = np.array((xyz[0], xyz[1], xyz[2] + size_m))
        self._drawn.add_label("selected text", fixed_frame, text, above)
        return ""

    def _send(self, aim: Aim, tool: Tool, window: Viewport, fixed_frame: str) -> str:
        """Send the message of a tool, and mark it; why it cannot, "" if it can."""
        tools = self._panel.publishers
        if tools is None:
            return ""
        ray = window.ray(aim.start)
        met = self._met(ray, ground_only=tool.has_heading)
        if met is None:
            return _NO_GROUND
        xyz, way_m = met
        yaw_rad = 0.0
        if tool.has_heading:
            xyz = (xyz[0], xyz[1], 0.0)
            yaw_rad = heading_of(ray, window.ray(aim.end), np.array(xyz))
        was_heard = tools.is_heard(tool)
        if not tools.send(tool, fixed_frame, xyz, yaw_rad):
            return tools.mistakes.get(tool.name, "Its topic has only just been changed.")
        topic = tools.topic(tool)
        text = sent_text(topic, fixed_frame, xyz, yaw_rad)
        self._panel.note(tool, text, was_heard=was_heard)
        size_m = mark_size(self._axes_m, way_m)
        kind, part = ("arrow", 1.0) if tool.has_heading else ("sphere", 0.25)
        sent = f"{tool.name} sent"
        self._mark(sent, fixed_frame, kind, tool.color, xyz, yaw_rad, part * size_m)
        above = np.array((xyz[0], xyz[1], xyz[2] + 0.3 * size_m))
        self._drawn.add_label(f"{tool.name} topic", fixed_frame, printable(topic), above)
        return ""

    def _met(self, ray: Ray, *, ground_only: bool = False) -> tuple[Place, float] | None:
        """The first place in a ray, on a drawn shape or on the ground, and the way to it in m."""
        way_m = ray.to_ground()
        if not ground_only:
            way_m = min(way_m, self._met_by(ray))
        if not math.isfinite(way_m):
            return None
        x, y, z = map(float, ray.at(way_m))
        return (x, y, z), way_m

    def _mark(
        self,
        name: str,
        frame: str,
        kind: str,
        color: tuple[int, int, int],
        xyz: Place,
        yaw_rad: float,
        size_m: float,
    ) -> None:
        """Put an arrow or a ball of this size into the scene, in the place of the former."""
        vertices, faces = unit_mesh(kind)
        scale = np.array((1.0, 0.25, 0.25) if kind == "arrow" else (1.0, 1.0, 1.0))
        pose = Transform.from_rpy(0.0, 0.0, yaw_rad, xyz)
        self._drawn.add(
            name,
            frame,
            lambda path: self._server.scene.add_mesh_simple(
                path,
                (vertices * scale * size_m).astype(np.float32),
                faces,
                color=color,
                cast_shadow=False,
                receive_shadow=False,
                **place_of(pose),
            ),
        )

    def _unmark(self, *names: str) -> None:
        for name in names:
            self._drawn.remove(name)


_NO_GROUND = "There is no ground: aim below the horizon."


def heading_of(ray: Ray, toward: Ray, at: Floats) -> float:
    """The yaw in rad of a drag from a ray, which meets the ground `at` (3,), to another; 0 for a
    click.
    """
    if toward.apart_px(ray) < _LEAST_DRAG_PX:
        return 0.0
    # Of a drag that ends above the horizon, the way that it points to.
    far_m = toward.to_ground()
    ahead = toward.at(far_m) - at if math.isfinite(far_m) else toward.direction
    return math.atan2(ahead[1], ahead[0])
