"""Browsers with their cameras, as viser has them. Not a test itself."""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np


def camera(position: tuple[float, float, float], look_at: tuple[float, float, float]) -> Any:
    """A browser's camera in a square window."""
    return SimpleNamespace(
        position=np.array(position), look_at=np.array(look_at), aspect=1.0, fov=math.radians(75.0)
    )


class Server:
    """The clients of a server of viser, with their cameras, by number."""

    def __init__(self, *cameras: Any) -> None:
        self.clients = {at: SimpleNamespace(camera=camera) for at, camera in enumerate(cameras)}
        self.initial_camera = camera((3.0, 3.0, 3.0), (0.0, 0.0, 0.0))

    def get_clients(self) -> dict[int, Any]:
        """As viser's."""
        return dict(self.clients)


def distance_m(seen: Any) -> float:
    """From a camera to what it looks at."""
    return float(np.linalg.norm(seen.position - seen.look_at))
