"""The tab of robots: which are drawn and how, and the sliders of their joints."""

import asyncio
import math
import time
from collections.abc import Mapping
from dataclasses import dataclass
from html import escape
from random import uniform
from typing import Any

import viser

from tfbus.base.wording import counted, listed, printable
from tfbus.robot.model import Joint
from tfbus.view.frames import Frames
from tfbus.view.panels.controls import Control, FrameDropdown
from tfbus.view.panels.markup import Channel, Html, event, sign
from tfbus.view.robots import Joints, ShownRobot
from tfbus.view.scene.robots import RobotScenes
from tfbus.view.settings import RANGES, SHAPES, ViewState

# More sliders are slow to show.
_MOST_SLIDERS = 100

# A slider that was dragged follows the joint again after this.
_HELD_S = 1.0

# The steps of sliders, in rad and m.
_STEP = 0.001

_FOLLOWS_ONLY = (
    "They follow <code>joint_states</code>. To move the robot from here, start "
    "<code>tfbus joints</code> with its URDF in the place of what publishes them now."
)
_STANDS_STILL = (
    "None of its frames is on the bus: the robot stands here by itself. "
    "<code>tfbus robot_state</code> publishes its frames."
)


def shown_position(joint: Joint, position: float) -> float:
    """The place of a position on a slider: of a continuous joint the same angle within one turn,
    and of others the nearest that they reach.
    """
    lower, upper = joint.reach
    if joint.type == "continuous":
        position = math.remainder(position, 2.0 * math.pi)
    return min(max(position, lower), upper)


def slider_joints(robot: ShownRobot) -> list[Joint]:
    """The joints that a slider can move: free ones with one number."""
    return [joint for joint in robot.robot.free_joints if joint.position_size == 1]


@dataclass(eq=False)
class Slider:
    """A slider of viser, the `handle`, and the joint that it moves and follows."""

    joint: Joint
    handle: Any
    # The last value that came from a drag or from the joint. With any other, a drag has just
    # changed the handle, and nobody was told yet.
    known: float
    held_until_s: float = 0.0

    def hold(self, value: float) -> None:
        """Stay at a value that the user chose, until the joint has had time to go there."""
        self.known = value
        self.held_until_s = time.monotonic() + _HELD_S

    def follow(self, position: float) -> None:
        """Go to where the joint is, unless the user drags."""
        if self.handle.value != self.known:
            self.hold(float(self.handle.value))
        value = round(shown_position(self.joint, position), 3)
        if time.monotonic() >= self.held_until_s and abs(self.known - value) >= _STEP / 2.0:
            self.known = self.handle.value = value


class JointSliders:
    """The sliders of one robot.

    A drag sends the target of that joint; a slider that is not dragged follows the joint. `buttons`
    are None without a joint that moves.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        robot: ShownRobot,
        joints: Joints | None,
        scenes: RobotScenes,
    ) -> None:
        self._joints = joints
        self._scenes = scenes
        self._note = Html(gui.add_html(""))
        self.sliders: list[Slider] = []
        self.buttons: Any = None
        movable = slider_joints(robot)
        if not movable:
            self._note.show('<div class="tf tf-dim">It has no joints that move.</div>')
            return
        self.buttons = gui.add_button_group("Joints", ("Zero", "Random"), visible=False)
        self.buttons.on_click(lambda event: self.press(self.buttons.value))
        for joint in movable[:_MOST_SLIDERS]:
            self._add(gui, joint)
        if len(movable) > _MOST_SLIDERS:
            more = len(movable) - _MOST_SLIDERS
            gui.add_html(f'<div class="tf tf-dim">{more} more joints have no slider.</div>')

    def _add(self, gui: viser.GuiApi, joint: Joint) -> None:
        lower, upper = joint.reach
        unit = "m" if joint.type == "prismatic" else "rad"
        least = round(lower, 3)
        handle: Any = gui.add_slider(
            printable(joint.name, 60),
            least,
            # A slider has two ends.
            max(round(upper, 3), least + _STEP),
            _STEP,
            round(shown_position(joint, joint.zero), 3),
            hint=f"{joint.type}, {lower:.3g} to {upper:.3g} {unit}",
            # `refresh` enables it: nobody may be there yet whom a drag would reach.
            disabled=True,
        )
        slider = Slider(joint, handle, float(handle.value))
        self.sliders.append(slider)

        # On viser's own thread, at once: until another one comes to it, the joint may have moved
        # the slider back.
        async def on_update(event: Any) -> None:
            # A change by the program has no client.
            if event.client is not None:
                value = float(handle.value)
                slider.hold(value)
                await asyncio.to_thread(self._send, {slider: value})

        handle.on_update(on_update)

    def refresh(self, is_still: bool) -> None:
        """Follow the joints, unless the robot stands by itself."""
        if self.buttons is None:
            return
        is_open = is_still or (self._joints is not None and self._joints.is_heard)
        # viser disables no group of buttons.
        if self.buttons.visible != is_open:
            self.buttons.visible = is_open
        for slider in self.sliders:
            if slider.handle.disabled == is_open:
                slider.handle.disabled = not is_open
        note = _STANDS_STILL if is_still else "" if is_open else _FOLLOWS_ONLY
        self._note.show(f'<div class="tf tf-dim">{note}</div>' if note else "")
        if is_still or self._joints is None:
            return
        positions = self._joints.positions
        for slider in self.sliders:
            position = positions.get(slider.joint.name)
            if position is not None:
                slider.follow(position)

    def press(self, button: str) -> None:
        """Move all joints, as the button Zero or Random does."""
        if button == "Zero":
            targets = {
                slider: shown_position(slider.joint, slider.joint.zero) for slider in self.sliders
            }
        else:
            targets = {slider: uniform(*slider.joint.reach) for slider in self.sliders}
        for slider, value in targets.items():
            slider.hold(round(value, 3))
            slider.handle.value = slider.known
        self._send(targets)

    def _send(self, targets: Mapping[Slider, float]) -> None:
        positions = {slider.joint.name: value for slider, value in targets.items()}
        self._scenes.move(positions)
        if self._joints is not None:
            self._joints.send(positions)


class RobotsPanel:
    """The controls of all robots, and with `has_sliders` the joints' of the chosen one."""

    title = "Robot"

    def __init__(
        self,
        gui: viser.GuiApi,
        view: ViewState,
        channel: Channel,
        scenes: RobotScenes,
        *,
        has_sliders: bool = True,
    ) -> None:
        self._gui = gui
        self._view = view
        self._scenes = scenes
        self._has_sliders = has_sliders
        self._chosen = ""
        self._shown: ShownRobot | None = None
        self._folder: Any = None
        self.sliders: JointSliders | None = None
        channel.on(
            "show robot",
            lambda e: view.tick("hidden_robots", str(e.get("robot", "")), not e.get("on")),
        )
        self._rows = Html(gui.add_html(""))
        settings = view.settings
        shapes: Any = gui.add_dropdown(
            "Shapes",
            SHAPES,
            initial_value=settings.shapes,
            hint="How the links look, and where they collide.",
        )
        Control(shapes, lambda value: view.change(shapes=value))
        least, most = RANGES["robot_opacity"]
        opacity: Any = gui.add_slider("Opacity", least, most, 0.05, settings.robot_opacity)
        Control(opacity, lambda value: view.change(robot_opacity=value))
        axes: Any = gui.add_checkbox(
            "Axes of links", settings.link_axes, hint="Axes, names and arrows of the links' frames."
        )
        Control(axes, lambda value: view.change(link_axes=value))
        self._choice: FrameDropdown | None = None
        self._order = axes.order

    def refresh(self, frames: Frames) -> None:
        """Show the robots that there are."""
        robots = list(self._scenes.robots)
        self._rows.show(
            f'<div class="tf">{"".join(self._row(robot, frames) for robot in robots)}</div>'
        )
        if not self._has_sliders:
            return
        if len(robots) > 1 and self._choice is None:
            self._choice = FrameDropdown(self._gui, "Joints of", "", self._choose)
        shown = next((each for each in robots if each.title == self._chosen), None)
        shown = shown or next(iter(robots), None)
        if self._choice is not None and shown is not None:
            titles = [robot.title for robot in robots[1:]]
            first = robots[0].title
            self._choice.offer(titles, "" if shown is robots[0] else shown.title, first)
        if shown is not self._shown:
            self._replace(shown)
        if self.sliders is not None and shown is not None:
            self.sliders.refresh(self._scenes.is_still(shown, frames))

    def _choose(self, title: str) -> None:
        self._chosen = title

    def _replace(self, robot: ShownRobot | None) -> None:
        if self._folder is not None:
            self._folder.remove()
        self._shown, self._folder, self.sliders = robot, None, None
        if robot is None:
            return
        joints = self._scenes.source.joints(robot)
        if joints is None and robot.is_described:
            return
        self._folder = self._gui.add_folder("Joints")
        with self._folder:
            self.sliders = JointSliders(self._gui, robot, joints, self._scenes)

    def _row(self, robot: ShownRobot, frames: Frames) -> str:
        title = escape(printable(robot.title))
        checked = "" if robot.title in self._view.settings.hidden_robots else "checked"
        box = event("show robot", robot="this.dataset.robot", on="this.checked")
        return (
            f'<div class="tf-row" data-robot-row="{title}">'
            f'<label class="tf-robot"><input type="checkbox" {checked} aria-label="show robot '
            f'{title}" data-robot="{escape(robot.title)}" onclick="{box}"><b>{title}</b></label>'
            f'<span class="tf-note">{self._note(robot, frames)}</span></div>'
        )

    def _note(self, robot: ShownRobot, frames: Frames) -> str:
        loaded, all_meshes = self._scenes.loaded(robot)
        if loaded < all_meshes:
            return f"{loaded} of {counted(all_meshes, 'mesh file')}"
        return state_of(robot, frames, self._scenes.is_still(robot, frames))


def state_of(robot: ShownRobot, frames: Frames, is_still: bool) -> str:
    """How a robot is, in a few words, as HTML."""
    known = [frames[frame] for frame in robot.frames.values() if frame in frames]
    if is_still:
        return "stands by itself"
    if not known:
        return "no frames yet"
    gone = sum(frame.state == "gone" for frame in known)
    if gone:
        # The root of the tree has no publisher that could be gone.
        is_all = gone + sum(frame.state == "root" for frame in known) == len(known)
        return f"{sign('gone')} gone" if is_all else f"{sign('gone')} {gone} of {len(known)} gone"
    missing = [link for link in robot.robot.links if robot.frame_of(link) not in frames]
    if missing:
        return f"without {escape(listed([printable(link) for link in missing], most=2))}"
    return counted(len(known), "link")


def progress_text(progress: tuple[int, int]) -> str:
    """How far meshes are loaded, "" once all are."""
    loaded, all_meshes = progress
    return f"{loaded} of {counted(all_meshes, 'mesh file')}" if loaded < all_meshes else ""
