"""`Robot`: the links and joints of a URDF, and the poses of its links."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from itertools import accumulate
from math import isfinite
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeAlias

from tfbus.base import lazy_numpy as np
from tfbus.base.errors import InvalidArgumentException, UrdfError
from tfbus.base.lazy_numpy import ArrayLike, NDArray
from tfbus.base.wording import counted, did_you_mean, printable
from tfbus.geometry.kernel import IDENTITY, compose, invert, normalised
from tfbus.geometry.rotations import matrix_of
from tfbus.geometry.transform import Transform, make_transform
from tfbus.geometry.transform_array import TransformArray
from tfbus.robot.kinematics import ManySteps, Position, Positions, Steps, local_pose, plane_axes
from tfbus.robot.mesh_files import MeshFiles, folder_of_source
from tfbus.robot.model import Collision, Joint, Link, Model, Visual
from tfbus.robot.urdf import read_model
from tfbus.robot.xml import MOST_BYTES, decoded, read_xml

Floats: TypeAlias = "NDArray[np.float64]"


FilePath = str | os.PathLike[str]

Edge = tuple[str, str, Transform]


class Robot:
    """A robot of a URDF: its links and joints, and the frames of the links (forward kinematics).

    `links` and `joints` are by name in the order of the URDF, `root` is the top link, `free_joints`
    are neither fixed nor mimics. `text` is the URDF, expanded if it was xacro, of the `files`.
    `warnings` are sentences on parts that it lacks.

    Positions are radians or metres: a map of names, or an array with the numbers of `free_joints`
    one after the other. A planar joint has three (x, y, angle), a floating one seven (x y z qx qy
    qz qw), or in a map a `Transform`. A joint that is not in the map is at its `zero`, a mimic
    follows its joint.

    Robots are immutable.
    """

    def __init__(self, model: Model, text: str, files: tuple[Path, ...] = ()) -> None:
        self._model = model
        self.name = model.name
        self.root = model.root
        self.links: Mapping[str, Link] = MappingProxyType(dict(model.links))
        self.joints: Mapping[str, Joint] = MappingProxyType(dict(model.joints))
        self.free_joints = tuple(joint for joint in model.joints.values() if joint.is_free)
        self.warnings = model.warnings
        self.text = text
        self.files = files
        self._positions = Positions(self.joints, self.free_joints)
        self._steps = Steps(model.root, model.down, self._positions.places)

    @staticmethod
    def from_urdf(
        path: FilePath,
        *,
        package_path: FilePath | Iterable[FilePath] = (),
        xacro_args: Mapping[str, object] | None = None,
    ) -> "Robot":
        """The robot of a URDF file, or of a xacro file: one whose name ends in `.xacro`.

        `package_path` are folders that hold the packages of `package://` and `$(find ...)`, or are
        one, searched first. `xacro_args` are the arguments of a xacro file by name.

        Raises UrdfError, with the line, if the file cannot be read or is not a URDF.
        """
        file = Path(path)
        files = MeshFiles(file.parent, _folders(package_path))
        try:
            with file.open("rb") as opened:
                data = opened.read(MOST_BYTES + 1)
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or error
            raise UrdfError(f"cannot read {printable(str(file))}: {reason}") from None
        text = decoded(data, str(file))
        if file.suffix != ".xacro":
            if xacro_args:
                raise UrdfError(f"{file} takes no arguments: it is not a .xacro file")
            return Robot(read_model(text, str(file), files), text, (file,))
        from tfbus.robot.xacro_file import expand

        read_xml(text, str(file))
        arguments = {name: _argument(value) for name, value in (xacro_args or {}).items()}
        expanded = expand(file, arguments, files)
        model = read_model(expanded.text, f"{file} (expanded)", files)
        model = replace(model, warnings=(*expanded.warnings, *model.warnings))
        return Robot(model, expanded.text, (file, *expanded.included))

    @staticmethod
    def from_text(
        text: str,
        *,
        folder: FilePath | None = None,
        package_path: FilePath | Iterable[FilePath] = (),
        name_of_source: str = "<text>",
    ) -> "Robot":
        """The robot of a URDF's text, such as came over the network. xacro is not expanded.

        Paths of meshes begin in `folder`, if given. Mistakes call the text `name_of_source`. Raises
        as `from_urdf`.
        """
        files = MeshFiles(None if folder is None else Path(folder), _folders(package_path))
        return Robot(read_model(text, name_of_source, files), text)

    def __reduce__(self) -> tuple[Any, ...]:
        return Robot, (self._model, self.text, self.files)

    def __repr__(self) -> str:
        return (
            f"<Robot {self.name!r}: {counted(len(self.links), 'link')}, "
            f"{counted(len(self.joints), 'joint')}, {len(self.free_joints)} free>"
        )

    @property
    def visuals(self) -> list[Visual]:
        """How all links look, in the order of the URDF."""
        return [visual for link in self.links.values() for visual in link.visuals]

    @property
    def collisions(self) -> list[Collision]:
        """The shapes in which all links collide, in the order of the URDF."""
        return [collision for link in self.links.values() for collision in link.collisions]

    # Positions

    @cached_property
    def dof(self) -> int:
        """How many columns the Jacobian has: 1 a free joint; 3 a planar, 6 a floating one."""
        return sum(min(joint.position_size, 6) for joint in self.free_joints)

    def zeros(self) -> dict[str, Position]:
        """The position of each free joint at rest: 0, or the middle of its limits if 0 is
        outside; of a planar joint (0, 0, 0), of a floating one the identity.
        """
        at_rest: dict[str, Position] = {}
        for joint, zero in zip(self.free_joints, self._positions.zeros, strict=False):
            at_rest[joint.name] = Transform.identity() if joint.type == "floating" else zero
        return at_rest

    # Frames

    def fk(
        self,
        positions: Mapping[str, Position] | ArrayLike | None = None,
        *,
        links: Iterable[str] | None = None,
    ) -> dict[str, Transform]:
        """The pose of each link in the root, or only of `links`: forward kinematics.

        Raises InvalidArgumentException for a joint or link that the robot does not have, and a
        position that is not finite.
        """
        values = self._positions.of_one(positions)
        names, numbers, way = self._wanted(links)
        poses = self._steps.poses(values, way)
        return {
            name: make_transform(poses[number]) for name, number in zip(names, numbers, strict=True)
        }

    def _wanted(
        self, links: Iterable[str] | None
    ) -> tuple[Sequence[str], Sequence[int], Sequence[int] | None]:
        """The names of the links, their numbers, and the steps to them, None for all."""
        if links is None:
            return self._steps.links, range(len(self._steps.links)), None
        names = [links] if isinstance(links, str) else list(links)
        numbers = [self._link_number(name) for name in names]
        return names, numbers, self._steps.way_to(numbers)

    def _link_number(self, link: str) -> int:
        number = self._steps.index.get(link)
        if number is None:
            raise InvalidArgumentException(
                f"the robot has no link {link!r}{did_you_mean(str(link), self.links)}"
            )
        return number

    def fk_many(
        self,
        positions: Mapping[str, ArrayLike] | ArrayLike,
        *,
        links: Iterable[str] | None = None,
    ) -> dict[str, TransformArray]:
        """The poses of each link in the root in N configurations at once.

        `positions` are a map of arrays (N,) by joint, (N, 3) or (N, 7), or one array (N, numbers of
        `free_joints`). A single number is for all.
        """
        values, count = self._positions.of_many(positions)
        names, numbers, way = self._wanted(links)
        return dict(zip(names, self._many_steps.poses(values, count, numbers, way), strict=True))

    @cached_property
    def _many_steps(self) -> ManySteps:
        return ManySteps(self._steps)

    def chain(self, a: str, b: str) -> tuple[Joint, ...]:
        """The joints on the way from link `a` to link `b`, first upwards, then downwards."""
        up, down = self._ways(self._link_number(a), self._link_number(b))
        steps = self._steps.steps
        return tuple(steps[number][0] for number in [*up, *reversed(down)])

    def _ways(self, a: int, b: int) -> tuple[list[int], list[int]]:
        """The steps from each of two links up to the first link that carries both."""
        steps = self._steps.steps
        up, down = [], []
        # A link's number is larger than that of its parent.
        while a != b:
            if a > b:
                up.append(a - 1)
                a = steps[a - 1][1]
            else:
                down.append(b - 1)
                b = steps[b - 1][1]
        return up, down

    def transform(
        self,
        target: str,
        source: str,
        positions: Mapping[str, Position] | ArrayLike | None = None,
    ) -> Transform:
        """The pose of link `source` in link `target`: takes points of the source into the target.

        As `lookup_transform` of a buffer. Raises as `fk`.
        """
        values = self._positions.of_one(positions)
        a, b = self._link_number(target), self._link_number(source)
        if a == b:
            return Transform.identity()
        up, down = self._ways(a, b)
        pose = IDENTITY
        for way in (up, down):
            climbed = IDENTITY
            for number in way:
                joint, _, origin, place = self._steps.steps[number]
                local = local_pose(joint, origin, values[place] if place >= 0 else None)
                climbed = normalised(compose(local, climbed))
            pose = compose(invert(pose), climbed)
        return make_transform(normalised(pose))

    def jacobian(
        self, link: str, positions: Mapping[str, Position] | ArrayLike | None = None
    ) -> Floats:
        """The Jacobian (6, `dof`) of a link: how fast it moves for the speeds of the free joints.

        The rows are the linear velocity of the link's origin (m/s), then its angular velocity
        (rad/s), in the axes of the root. The columns are the free joints in order, with their
        mimics: one each; of a planar joint x, y and angle; of a floating one the linear, then the
        angular velocity of its child in the axes of the joint's frame.
        """
        values = self._positions.of_one(positions)
        number = self._link_number(link)
        way = self._steps.way_to([number])
        poses = self._steps.poses(values, way)
        tip = np.array(poses[number][:3])
        jacobian = np.zeros((6, self.dof))
        for step in way:
            joint, parent, origin, place = self._steps.steps[step]
            if place < 0:
                continue
            frame = np.array(matrix_of(*compose(poses[parent], origin)[3:]))
            lever = tip - poses[step + 1][:3]
            column, factor = self._columns[place]
            part = factor * _velocities(joint, frame, lever)
            jacobian[:, column : column + part.shape[1]] += part
        return jacobian

    @cached_property
    def _columns(self) -> list[tuple[int, float]]:
        """Of each joint that moves, by place: its first column of the Jacobian, and its factor."""
        sizes = [min(joint.position_size, 6) for joint in self.free_joints]
        columns = [(end - size, 1.0) for end, size in zip(accumulate(sizes), sizes, strict=True)]
        for _, _, source, mimic in self._positions.mimics:
            column, factor = columns[source]
            columns.append((column, factor * mimic.multiplier))
        return columns

    # Transforms to publish

    def static_transforms(self, prefix: str = "") -> list[Edge]:
        """Parent, child and pose of each fixed joint; `prefix` is put before the names."""
        return [
            (prefix + joint.parent, prefix + joint.child, joint.origin)
            for joint in self.joints.values()
            if joint.type == "fixed"
        ]

    def joint_transforms(self, positions: Mapping[str, Position], prefix: str = "") -> list[Edge]:
        """Parent, child and pose of each joint that `positions` names and of its mimics.

        A mimic joint follows the first of its chain that is named, unless it is named itself;
        `prefix` is put before the names. Raises as `fk`, and for a pose that is not finite.
        """
        values = self._positions.of_one(positions)
        moved = dict.fromkeys(positions)
        for _, name, _, mimic in self._positions.mimics:
            if mimic.joint in moved:
                moved[name] = None
        edges = []
        for name in moved:
            joint, position = self.joints[name], values[self._positions.places[name]]
            pose = local_pose(joint, joint.origin.as_pose(), position)
            if not (isfinite(pose[0]) and isfinite(pose[1]) and isfinite(pose[2])):
                raise InvalidArgumentException(
                    f"joint {name!r} at {position} puts link {joint.child!r} further away than a "
                    "number can say"
                )
            edges.append(
                (prefix + joint.parent, prefix + joint.child, make_transform(normalised(pose)))
            )
        return edges


def _velocities(joint: Joint, frame: Floats, lever: Floats) -> Floats:
    """The columns of a joint of the Jacobian (6, 1, 3 or 6): `frame` is the matrix (3, 3) of its
    frame in the root, `lever` leads from its child's origin to the moved point.
    """
    slides: list[Any] = []
    turns: list[Any] = []
    if joint.type == "prismatic":
        slides = [joint.axis]
    elif joint.type == "planar":
        slides, turns = list(plane_axes(joint.axis)), [joint.axis]
    elif joint.type == "floating":
        slides = turns = list(np.eye(3))
    else:
        turns = [joint.axis]
    columns = [np.concatenate((frame @ axis, np.zeros(3))) for axis in slides]
    for axis in turns:
        about = frame @ axis
        columns.append(np.concatenate((np.cross(about, lever), about)))
    return np.column_stack(columns)


def _folders(given: FilePath | Iterable[FilePath]) -> list[Path]:
    if isinstance(given, str | os.PathLike):
        return [Path(given)]
    return [Path(each) for each in given]


def _argument(value: object) -> str:
    """An argument as xacro has it: a text."""
    return str(value).lower() if isinstance(value, bool) else str(value)


def read_described(urdf: str, source: str, package_path: Sequence[Path], called: str) -> Robot:
    """The robot of a description; if it has no `source`, mistakes call it `called`.

    Files of this machine are only in `package_path` and in installed packages: a `source` counts
    if it lies in one of these folders. Raises UrdfError.
    """
    folder, within = folder_of_source(source, package_path) or (None, None)
    files = MeshFiles(folder, package_path, within)
    return Robot(read_model(urdf, printable(source or called), files), urdf)


def remedy_of_missing(package: str) -> str:
    """The stand-in of a described mesh, of this package or "" for none, that is not on this
    machine.
    """
    if package:
        return f"--package-path names the folder with package {printable(package, 60)!r}"
    return "--package-path names a folder around its URDF, --urdf shows the robot of a file"
