"""Publishes the bodies of a MuJoCo simulation as frames: here a double pendulum with a camera.

    pip install mujoco
    python examples/mujoco_world.py
    python examples/mujoco_world.py --param model=scene.xml

`tfbus view` shows it. The simulation keeps pace with the clock of the machine; simulated_time.py
shows how one sets the time for others. Ctrl-C ends it.
"""

import mujoco

from tfbus import (
    Node,
    StaticTransformBroadcaster,
    Transform,
    TransformBroadcaster,
    TransformStamped,
)

PENDULUM = """
<mujoco>
  <worldbody>
    <body name="mast" pos="0 0 2">
      <geom type="box" size="0.05 0.05 0.05"/>
      <body name="upper" pos="0 0.1 0">
        <joint axis="0 1 0" damping="0.01"/>
        <geom type="capsule" fromto="0 0 0 0.6 0 0" size="0.03"/>
        <body name="lower" pos="0.6 0.1 0">
          <joint axis="0 1 0" damping="0.01"/>
          <geom type="capsule" fromto="0 0 0 0.4 0 0" size="0.03"/>
          <body name="camera" pos="0.4 0 0">
            <geom type="box" size="0.02 0.03 0.02"/>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


def main() -> None:
    with Node.from_args("mujoco") as node:
        path = node.declare_parameter("model", "", description="An MJCF or URDF file.").value
        load = mujoco.MjModel.from_xml_path if path else mujoco.MjModel.from_xml_string
        try:
            model = load(path or PENDULUM)
        except ValueError as error:
            raise SystemExit(f"Error: {error}") from None
        data = mujoco.MjData(model)
        bodies = range(1, model.nbody)  # body 0 is the world
        names = [model.body(body).name or f"body_{body}" for body in range(model.nbody)]
        moving = [body for body in bodies if model.body_dofnum[body]]
        start_ns = node.now_ns()

        def frame(body: int) -> TransformStamped:
            parent = model.body_parentid[body]
            world_from_parent, world_from_body = (
                Transform.from_quat_wxyz(data.xquat[each], data.xpos[each])
                for each in (parent, body)
            )
            return TransformStamped(
                start_ns + round(data.time * 1e9),
                names[parent],
                names[body],
                world_from_parent.inverse() @ world_from_body,
            )

        def step() -> None:
            while start_ns + (data.time + model.opt.timestep) * 1e9 <= node.now_ns():
                mujoco.mj_step(model, data)
            mujoco.mj_kinematics(model, data)  # where the bodies are at the end of the step
            broadcaster.send_transform([frame(body) for body in moving])

        mujoco.mj_kinematics(model, data)
        fixed = [frame(body) for body in bodies if body not in moving]
        StaticTransformBroadcaster(node).send_transform(fixed)
        broadcaster = TransformBroadcaster(node)
        node.create_timer(0.02, step)
        node.spin()


if __name__ == "__main__":
    main()
