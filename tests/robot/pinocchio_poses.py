"""Poses of links by Pinocchio, which parses URDF with urdfdom: run by a Python that has it.

Each line of the standard input is JSON: `urdf`, the file; `positions`, an .npz file with an array
(N,) a joint; `poses`, the .npz file to write, with the matrices (N, 4, 4) of each link in the root
link. The answer is a line: "done", or why not.
"""

import json
import sys
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio


def model_of(urdf: str, positions: dict[str, Any]) -> Any:
    """The model. Pinocchio wants a mimic joint after its source: elsewhere both are free, and the
    position of the mimic joint is added here.
    """
    try:
        return pinocchio.buildModelFromUrdf(urdf, mimic=True)
    except ValueError:
        model = pinocchio.buildModelFromUrdf(urdf)
    mimics = {
        joint.get("name"): mimic
        for joint in ElementTree.parse(urdf).getroot().iter("joint")
        if joint.get("type") != "fixed" and (mimic := joint.find("mimic")) is not None
    }
    while ready := [name for name, mimic in mimics.items() if mimic.get("joint") in positions]:
        for name in ready:
            mimic = mimics.pop(name)
            factor, offset = float(mimic.get("multiplier", 1)), float(mimic.get("offset", 0))
            positions[name] = positions[mimic.get("joint")] * factor + offset
    return model


def poses(urdf: str, positions: dict[str, Any], count: int) -> dict[str, Any]:
    """The matrices (N, 4, 4) of all links."""
    model = model_of(urdf, positions)
    data = model.createData()
    frames = [
        (number, frame.name)
        for number, frame in enumerate(model.frames)
        if frame.type == pinocchio.FrameType.BODY
    ]
    configurations = np.tile(pinocchio.neutral(model), (count, 1))
    for name, values in positions.items():
        if not model.existJointName(name):
            raise ValueError(f"no joint {name}")
        joint = model.joints[model.getJointId(name)]
        if "Mimic" in joint.shortname():
            continue
        if joint.nq == 1:
            configurations[:, joint.idx_q] = values
        elif joint.nq == 2:  # continuous
            configurations[:, joint.idx_q] = np.cos(values)
            configurations[:, joint.idx_q + 1] = np.sin(values)
        elif joint.nq == 4:  # planar: x, y and the direction
            configurations[:, joint.idx_q : joint.idx_q + 2] = values[:, :2]
            configurations[:, joint.idx_q + 2] = np.cos(values[:, 2])
            configurations[:, joint.idx_q + 3] = np.sin(values[:, 2])
        else:
            configurations[:, joint.idx_q : joint.idx_q + 7] = values
    used = sorted({model.frames[number].parentJoint for number, _ in frames})
    joints = {number: np.empty((count, 4, 4)) for number in used}
    for row, configuration in enumerate(configurations):
        pinocchio.forwardKinematics(model, data, configuration)
        for number, rows in joints.items():
            rows[row] = data.oMi[number].homogeneous
    return {
        name: joints[model.frames[number].parentJoint] @ model.frames[number].placement.homogeneous
        for number, name in frames
    }


def main() -> None:
    """Answer line by line."""
    for line in sys.stdin:
        request = json.loads(line)
        positions = dict(np.load(request["positions"]))
        try:
            found = poses(request["urdf"], positions, request["count"])
            np.savez(request["poses"], **found)
        except Exception as error:
            print(" ".join(str(error).split()) or type(error).__name__, flush=True)
        else:
            print("done", flush=True)


if __name__ == "__main__":
    main()
