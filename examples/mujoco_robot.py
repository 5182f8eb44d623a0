"""Simulates a robot in a room by MuJoCo: it drives about, with a camera and a scanner.

    pip install mujoco
    python examples/mujoco_robot.py

`tfbus view --topic scan --topic points --topic camera/image` shows it. Its camera needs OpenGL:
without a display, `MUJOCO_GL=egl` or `MUJOCO_GL=osmesa`. Where there is none, it sees by rays.
Ctrl-C ends it.
"""

import math
import os
import sys
from threading import Lock

if sys.platform == "linux" and not os.environ.get("DISPLAY"):
    os.environ.setdefault("MUJOCO_GL", "egl")  # before MuJoCo is imported

import mujoco
import numpy as np

from tfbus import (
    Node,
    StaticTransformBroadcaster,
    Transform,
    TransformBroadcaster,
    TransformStamped,
)
from tfbus.messages import CameraInfo, Image, LaserScan, PointCloud

ROOM = """
<mujoco>
  <visual><global offwidth="320" offheight="240"/><headlight ambient="0.4 0.4 0.4"/></visual>
  <asset>
    <texture name="sky" type="skybox" builtin="gradient" rgb1="0.6 0.75 0.9" rgb2="0.9 0.95 1"
             width="64" height="64"/>
    <texture name="tiles" type="2d" builtin="checker" rgb1="0.55 0.5 0.45" rgb2="0.7 0.65 0.6"
             width="128" height="128"/>
    <material name="tiles" texture="tiles" texrepeat="8 8"/>
  </asset>
  <default><geom rgba="0.85 0.8 0.7 1"/></default>
  <worldbody>
    <light pos="0 0 5" dir="0 0 -1"/>
    <geom type="plane" size="4 4 0.1" material="tiles"/>
    <geom type="box" size="0.1 4 0.6" pos="4 0 0.6"/>
    <geom type="box" size="0.1 4 0.6" pos="-4 0 0.6"/>
    <geom type="box" size="4 0.1 0.6" pos="0 4 0.6"/>
    <geom type="box" size="4 0.1 0.6" pos="0 -4 0.6"/>
    <geom type="box" size="0.4 0.4 0.4" pos="0 0 0.4" rgba="0.8 0.3 0.2 1"/>
    <geom type="cylinder" size="0.3 0.5" pos="3 2.4 0.5" rgba="0.2 0.5 0.8 1"/>
    <geom type="cylinder" size="0.2 0.5" pos="-2.8 -3 0.5" rgba="0.3 0.6 0.3 1"/>
    <body name="base" pos="2 0 0.15">
      <joint name="x" type="slide" axis="1 0 0" damping="20"/>
      <joint name="y" type="slide" axis="0 1 0" damping="20"/>
      <joint name="yaw" axis="0 0 1" damping="2"/>
      <geom type="box" size="0.25 0.18 0.1" mass="10" group="1" rgba="0.3 0.3 0.35 1"/>
      <body name="scanner" pos="0.1 0 0.2">
        <geom type="cylinder" size="0.06 0.04" mass="0.1" group="1" rgba="0.1 0.1 0.1 1"/>
      </body>
      <body name="mast" pos="0.2 0 0.3">
        <joint name="pan" axis="0 0 1" damping="0.1"/>
        <geom type="box" size="0.02 0.05 0.03" mass="0.1" group="1" rgba="0.1 0.1 0.1 1"/>
        <camera name="camera" pos="0.03 0 0" xyaxes="0 -1 0 0 0 1" fovy="60"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <velocity joint="x" kv="200"/>
    <velocity joint="y" kv="200"/>
    <velocity joint="yaw" kv="20"/>
    <position joint="pan" kp="2"/>
  </actuator>
</mujoco>
"""
WIDTH, HEIGHT, FOV_DEGREES = 320, 240, 60.0
FOCAL = HEIGHT / 2 / math.tan(math.radians(FOV_DEGREES) / 2)
RANGE_M = 12.0


# Of the geoms these groups are seen by rays: not the robot's own.
OTHERS = np.array([1, 0, 1, 1, 1, 1], np.uint8)
TURN = np.linspace(-math.pi, math.pi, 360, endpoint=False)
RISE = np.radians(np.linspace(-15, 15, 10))


class Eye:
    """Measures distances along rays, and takes pictures."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        self._model, self._data = model, data
        try:
            self._renderer = mujoco.Renderer(model, HEIGHT, WIDTH)
        except Exception as error:  # each OpenGL has its own
            print(f"No OpenGL, so the camera sees by rays: {error}", file=sys.stderr, flush=True)
            self._renderer = None

    def ranges(self, origin: Transform, directions: np.ndarray) -> np.ndarray:
        """How far it is from `origin` along directions in its frame (N, 3); inf for nothing."""
        count = len(directions)
        geoms, found = np.zeros(count, np.int32), np.zeros(count)
        ends = (directions @ origin.as_matrix()[:3, :3].T).ravel()
        at = (self._model, self._data, origin.xyz, ends, OTHERS, True, -1)
        mujoco.mj_multiRay(*at, geoms, found, None, count, RANGE_M)
        return np.where(found < 0, np.inf, found)

    def aim(self) -> None:
        """Take the next picture of what is there now."""
        if self._renderer is not None:
            self._renderer.update_scene(self._data, "camera")

    def picture(self, camera: Transform) -> np.ndarray:
        """The pixels (HEIGHT, WIDTH, 3) of the camera, whose frame was at `camera`."""
        if self._renderer is not None:
            return self._renderer.render()
        rows, columns = np.mgrid[0:HEIGHT:4, 0:WIDTH:4]
        ahead = (columns - WIDTH / 2, rows - HEIGHT / 2, np.full(rows.shape, FOCAL))
        towards = np.stack(ahead, axis=-1).reshape(-1, 3)
        towards /= np.linalg.norm(towards, axis=1, keepdims=True)
        near = 255 / (1 + self.ranges(camera, towards).reshape(rows.shape))
        return near.astype(np.uint8).repeat(4, 0).repeat(4, 1)[..., None].repeat(3, 2)


def directions(turn: np.ndarray, rise: np.ndarray) -> np.ndarray:
    """The directions (N, 3) of rays to the left by `turn` and up by `rise`, each for each."""
    turn, rise = (each.ravel() for each in np.meshgrid(turn, rise))
    return np.stack(
        (np.cos(turn) * np.cos(rise), np.sin(turn) * np.cos(rise), np.sin(rise)), axis=1
    )


def steer(data: mujoco.MjData) -> None:
    """Drive around the block in the middle, and look about."""
    x, y, yaw, _ = data.qpos
    x += 2.0  # where the base begins
    heading = math.atan2(y, x) + math.pi / 2 + 0.8 * (math.hypot(x, y) - 2.2)
    turn = math.remainder(heading - yaw, 2 * math.pi)
    pan = 0.5 * math.sin(0.7 * data.time)
    data.ctrl[:] = (0.5 * math.cos(yaw), 0.5 * math.sin(yaw), turn, pan)


def main() -> None:
    """Simulate and publish until Ctrl-C."""
    model = mujoco.MjModel.from_xml_string(ROOM)
    data = mujoco.MjData(model)
    data.joint("yaw").qpos = math.pi / 2
    mujoco.mj_forward(model, data)
    eye = Eye(model, data)

    def pose(body: str) -> Transform:
        return Transform.from_quat_wxyz(data.body(body).xquat, data.body(body).xpos)

    with Node.from_args("mujoco_robot") as node:
        static, broadcaster = StaticTransformBroadcaster(node), TransformBroadcaster(node)
        scanner_at = pose("base").inverse() @ pose("scanner")
        camera_at = Transform.from_rpy(-math.pi / 2, 0, -math.pi / 2, xyz=(0.03, 0, 0))
        static.send_transform(
            [
                TransformStamped(0, "base", "scanner", scanner_at),
                TransformStamped(0, "mast", "camera", camera_at),
            ]
        )
        scans = node.create_publisher(LaserScan, "scan")
        clouds = node.create_publisher(PointCloud, "points")
        images = node.create_publisher(Image, "camera/image")
        infos = node.create_publisher(CameraInfo, "camera/camera_info")
        start_ns, still = node.now_ns(), Lock()
        level, around = directions(TURN, np.zeros(1)), directions(TURN[::2], RISE)

        def stamp_ns() -> int:
            return start_ns + round(data.time * 1e9)

        def step() -> None:
            with still:
                while stamp_ns() + model.opt.timestep * 1e9 <= node.now_ns():
                    steer(data)
                    mujoco.mj_step(model, data)
                mujoco.mj_forward(model, data)  # where all is at the end of the step
            base, mast = pose("base"), pose("mast")
            broadcaster.send_transform(
                [
                    TransformStamped(stamp_ns(), "world", "base", base),
                    TransformStamped(stamp_ns(), "base", "mast", base.inverse() @ mast),
                ]
            )

        def measure() -> None:
            scanner = pose("scanner")
            turns = (-math.pi, math.pi, 2 * math.pi / len(TURN))
            ranges = eye.ranges(scanner, level)
            scans.publish(LaserScan(stamp_ns(), "scanner", *turns, 0, 0, 0.1, RANGE_M, ranges))
            far = eye.ranges(scanner, around)
            seen = np.isfinite(far)
            xyz = around[seen] * far[seen, None]
            clouds.publish(PointCloud.from_xyz(stamp_ns(), "scanner", xyz))

        node.create_timer(0.02, step)
        node.create_timer(0.1, measure)
        k = (FOCAL, 0, WIDTH / 2, 0, FOCAL, HEIGHT / 2, 0, 0, 1)
        # On this thread: OpenGL belongs to one, and may take longer than the steps have.
        while node.wait(0.2):
            with still:
                taken_ns, camera = stamp_ns(), pose("mast") @ camera_at
                eye.aim()
            pixels = eye.picture(camera)
            images.publish(Image.from_pixels(taken_ns, "camera", pixels))
            infos.publish(CameraInfo(taken_ns, "camera", HEIGHT, WIDTH, k=k))


if __name__ == "__main__":
    main()
