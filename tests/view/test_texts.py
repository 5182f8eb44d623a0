"""Texts of markers: their colour and size, and that they face each browser in their places."""

from io import BytesIO
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from tests.view.cameras import Server, camera
from tfbus import Transform
from tfbus.messages import ColorRGBA, Marker, Vector3

pytest.importorskip("viser", reason="needs viser: the extra view")

import trimesh

from tfbus.view.data.markers import item_of
from tfbus.view.data.shapes import Text
from tfbus.view.scene.texts import Texts, picture_of_text

ORANGE = (230, 120, 20)
UNKNOWN = "\U0010fffd"


class Scene:
    """The pictures and labels of a browser, by path."""

    def __init__(self) -> None:
        self.there: dict[str, Any] = {}

    def add_image(self, path: str, rgba: Any, **shape: Any) -> Any:
        """As viser's."""
        node = SimpleNamespace(name=path, rgba=rgba, remove=lambda: self.there.pop(path), **shape)
        self.there[path] = node
        return node

    def add_glb(self, path: str, model: bytes, **shape: Any) -> Any:
        """As viser's."""
        return self.add_image(path, model, **shape)

    def add_label(self, path: str, text: str, **shape: Any) -> Any:
        """As viser's."""
        return self.add_image(path, text, **shape)


def server_of(*turns: tuple[float, float, float, float]) -> Any:
    """A server with a browser for each rotation of a camera, w first."""
    server = Server(*(camera((1.0, 0.0, 0.0), (0.0, 0.0, 0.0)) for _ in turns))
    for number, wxyz in enumerate(turns):
        server.clients[number].camera.wxyz = np.array(wxyz)
        server.clients[number].scene = Scene()
    return server


def test_a_text_of_a_marker_has_its_colour_height_and_opacity() -> None:
    """As in RViz."""
    look = {"scale": Vector3(1, 1, 0.25), "color": ColorRGBA(1, 0.5, 0, 0.5)}
    marker = Marker(0, "map", type=Marker.TEXT_VIEW_FACING, text="here", **look)
    [shape] = item_of(marker).shapes
    assert isinstance(shape, Text)
    assert shape.is_like(Text("here", 0.25, (255, 127, 0), 0.5))


def test_letters_have_their_colour_and_the_rest_is_clear() -> None:
    """Two lines are twice as high; a letter of no font is left to the browser."""
    picture = picture_of_text("H", ORANGE)
    assert picture is not None
    full = picture.rgba[picture.rgba[..., 3] == 255]
    assert (full[:, :3] == ORANGE).all(axis=1).any()
    assert picture.rgba[0, 0, 3] == 0
    assert picture.rgba.shape[0] == pytest.approx(picture.letter_px, abs=10)
    lines = picture_of_text("H\nH", ORANGE)
    assert lines is not None
    assert lines.rgba.shape[0] > 1.8 * picture.rgba.shape[0]
    assert picture_of_text(f"H{UNKNOWN}", ORANGE) is None


def test_a_long_text_is_as_high_as_a_short_one() -> None:
    """Its picture is made smaller, for browsers take none of any size."""
    long = picture_of_text("H" * 500, ORANGE)
    assert long is not None
    assert max(long.rgba.shape) <= 2048
    assert long.rgba.shape[0] == pytest.approx(long.letter_px, abs=4)


@pytest.mark.parametrize("letters", ["robot 7", UNKNOWN])
def test_a_text_faces_each_browser_where_its_place_is_in_that_picture(letters: str) -> None:
    """Also while the fixed frame moves, as it does when cameras follow another."""
    turns = ((1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0))
    server = server_of(*turns)
    texts = Texts(cast(Any, server))
    at = Transform((1.0, 2.0, 3.0))
    for moved in (Transform(), Transform.from_rpy(0.0, 0.0, 1.0, xyz=(5.0, 0.0, 0.0))):
        texts.draw({"a": (Text(letters, 0.2, ORANGE), at)}, moved)
        for number, wxyz in enumerate(turns):
            [node] = server.clients[number].scene.there.values()
            np.testing.assert_allclose(node.position, moved.apply(at.xyz))
            assert tuple(node.wxyz) == wxyz


def test_the_clear_parts_of_a_text_hide_nothing() -> None:
    """An opaque text is a model without them, of the size of the picture."""
    server = server_of((1.0, 0.0, 0.0, 0.0))
    Texts(server).draw({"a": (Text("H", 0.2, ORANGE), Transform())}, Transform())
    [node] = server.clients[0].scene.there.values()
    [mesh] = trimesh.load(BytesIO(node.rgba), file_type="glb").geometry.values()
    assert mesh.visual.material.alphaMode == "MASK"
    picture = picture_of_text("H", ORANGE)
    assert picture is not None
    height_px, width_px = picture.rgba.shape[:2]
    wanted = np.array((width_px, height_px, 0)) * 0.2 / picture.letter_px
    np.testing.assert_allclose(mesh.extents, wanted, atol=1e-6)


def test_a_text_that_stays_is_kept_and_one_that_is_gone_removed() -> None:
    """Another text takes its place in the scene."""
    server = server_of((1.0, 0.0, 0.0, 0.0))
    texts = Texts(cast(Any, server))
    there = server.clients[0].scene.there
    made = []
    for letters in ("one", "one", "two"):
        texts.draw({"a": (Text(letters, 0.2, ORANGE), Transform())}, Transform())
        made += there.values()
    assert made[0] is made[1]
    assert made[2] is not made[1]
    assert made[2].name == made[1].name
    texts.draw({}, Transform())
    assert not there
