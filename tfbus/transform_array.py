"""Many transforms as arrays: what a lookup of many stamps answers."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]


class TransformArray(NamedTuple):
    """N transforms: `xyz` (N, 3) in metres, `quat_xyzw` (N, 4) unit quaternions x, y, z, w.

    It unpacks into the two arrays: `xyz, quat_xyzw = buffer.lookup_transforms(...)`.
    """

    xyz: Floats
    quat_xyzw: Floats

    def as_matrix(self) -> Floats:
        """The homogeneous matrices (N, 4, 4)."""
        x, y, z, w = np.moveaxis(self.quat_xyzw, -1, 0)
        matrices = np.zeros((len(self.xyz), 4, 4))
        matrices[:, 0, 0] = 1 - 2 * (y * y + z * z)
        matrices[:, 0, 1] = 2 * (x * y - z * w)
        matrices[:, 0, 2] = 2 * (x * z + y * w)
        matrices[:, 1, 0] = 2 * (x * y + z * w)
        matrices[:, 1, 1] = 1 - 2 * (x * x + z * z)
        matrices[:, 1, 2] = 2 * (y * z - x * w)
        matrices[:, 2, 0] = 2 * (x * z - y * w)
        matrices[:, 2, 1] = 2 * (y * z + x * w)
        matrices[:, 2, 2] = 1 - 2 * (x * x + y * y)
        matrices[:, :3, 3] = self.xyz
        matrices[:, 3, 3] = 1.0
        return matrices

    def inverse(self) -> "TransformArray":
        """Each motion back."""
        back = self.quat_xyzw * np.array((-1.0, -1.0, -1.0, 1.0))
        return TransformArray(-rotate(back, self.xyz), back)

    def apply(self, points: ArrayLike) -> Floats:
        """Point i of (N, 3), taken by transform i from the child into the parent."""
        return rotate(self.quat_xyzw, np.asarray(points, dtype=np.float64)) + self.xyz

    def as_scipy(self) -> Any:
        """As N scipy RigidTransforms; needs scipy 1.16 or newer."""
        from scipy.spatial.transform import RigidTransform, Rotation

        return RigidTransform.from_components(self.xyz, Rotation.from_quat(self.quat_xyzw))


def rotate(quat_xyzw: Floats, vectors: Floats) -> Floats:
    """Vectors (N, 3), each turned by the quaternion (N, 4) of its row."""
    axis, w = quat_xyzw[..., :3], quat_xyzw[..., 3:]
    twice = 2.0 * np.cross(axis, vectors)
    turned: Floats = vectors + w * twice + np.cross(axis, twice)
    return turned
