"""The length of the axes and the cells of the grid, which fit what is drawn."""

from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pytest

pytest.importorskip("viser", reason="needs viser: the extra view")

from tfbus.view.frames import Placed
from tfbus.view.scene.scene import DataExtent, Scene
from tfbus.view.settings import ViewSettings


def placed(extent_m: float) -> Placed:
    """Two frames so far apart."""
    xyz = np.array([(0.0, 0.0, 0.0), (extent_m, 0.0, 0.0)])
    return Placed(("map", "base"), xyz, np.tile((1.0, 0.0, 0.0, 0.0), (2, 1)), {})


@pytest.fixture
def grid() -> Any:
    """The grid in a browser."""
    return MagicMock()


@pytest.fixture
def scene(grid: Any) -> Scene:
    """A scene that no browser shows."""
    return Scene(MagicMock(**{"add_grid.return_value": grid}), lambda client, name: None)


def sizes(scene: Scene, data_m: float, scale: float = 1.0, frames_m: float = 1.0) -> float:
    """The length of the axes beside messages of this size, in m."""
    scene.fit(placed(frames_m), ViewSettings(scale=scale), 0.0, data_m)
    return scene.size_m


def test_the_grid_has_some_cells_below_a_cloud(scene: Scene, grid: Any) -> None:
    """Cells of a tenth of a metre below frames become cells of 10 m below 50 m of points."""
    sizes(scene, 0.0)
    assert grid.cell_size == pytest.approx(0.1)
    sizes(scene, 50.0)
    assert (grid.cell_size, grid.fade_distance) == (10.0, 600.0)


def test_axes_are_seen_beside_a_cloud_and_do_not_hide_their_frames(scene: Scene) -> None:
    """A 25th of the cloud, and at most eight times as long as without it."""
    assert sizes(scene, 0.0) == pytest.approx(0.1)
    assert sizes(scene, 10.0) == pytest.approx(0.4)
    assert sizes(scene, 1000.0) == pytest.approx(0.8)
    assert sizes(scene, 0.0) == pytest.approx(0.1)


def test_messages_smaller_than_the_frames_change_nothing(scene: Scene, grid: Any) -> None:
    """The axes fit the frames, and so does the grid."""
    assert sizes(scene, 0.5, frames_m=20.0) == pytest.approx(2.0)
    assert grid.cell_size == 10.0


def test_axes_that_were_scaled_stay_when_a_cloud_comes(scene: Scene, grid: Any) -> None:
    """And keep the length that was scaled, though the cloud grows; the grid has no scale."""
    assert sizes(scene, 0.0, scale=2.0) == pytest.approx(0.2)
    assert sizes(scene, 50.0, scale=2.0) == pytest.approx(0.2)
    assert grid.cell_size == 10.0
    before = sizes(scene, 10.0)
    assert sizes(scene, 10.0, scale=1.1) == pytest.approx(1.1 * before)
    assert sizes(scene, 1000.0, scale=1.1) == pytest.approx(1.1 * before)


def test_nothing_jumps_with_each_scan(scene: Scene, grid: Any) -> None:
    """A robot goes from a hall into a room and back: the largest scan counts until its box is
    unticked.
    """
    extent = DataExtent()
    found = set()
    for scan_m in (30.0, 3.0, 25.0, 31.0, 1.0):
        extent.see(np.array([(0.0, 0.0, 0.0), (scan_m, 1.0, 0.0)]), ["scan"])
        found.add((sizes(scene, extent.m), grid.cell_size))
    assert len(found) == 1
    extent.see(np.zeros((0, 3)), [])
    assert extent.m == 0.0


def test_a_few_wrong_points_do_not_count() -> None:
    """One of a hundred may be anywhere."""
    xyz = np.column_stack((np.linspace(0.0, 10.0, 100), np.zeros((100, 2))))
    xyz[50] = 1e9
    extent = DataExtent()
    extent.see(xyz, ["scan"])
    assert 9.0 < extent.m < 10.0
