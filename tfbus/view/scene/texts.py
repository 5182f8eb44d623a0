"""Texts of messages: letters in their colour that face each browser, as RViz draws them.

viser's own labels are black on white, and follow a frame that moves one picture later: only letters
that no font of this machine has are drawn by them.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import trimesh
import viser
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont
from trimesh.exchange.gltf import export_glb
from trimesh.visual.material import PBRMaterial
from trimesh.visual.texture import TextureVisuals

from tfbus.geometry.transform import Transform
from tfbus.view.data.shapes import Text

# Each is an object of its own in a browser, and so many are made in one step.
_MOST_TEXTS = 300
_MOST_NEW = 20

# In pixels of the picture: of the font, of the line around letters, and the widest picture.
_FONT_PX = 48
_STROKE_PX = 3
_MOST_PX = 2048

# Fonts that have more letters than the one that Pillow brings.
_FONTS = ("DejaVuSans.ttf", "NotoSans-Regular.ttf", "Arial.ttf")

# Less is clear, and light does not change the colours: in the words of glTF.
_LEAST_ALPHA = 0.4
_UNLIT = "KHR_materials_unlit"

# Darker colours have a light line around them.
_DARK = 110.0


class Texts:
    """The texts in the scenes of all browsers."""

    def __init__(self, server: viser.ViserServer) -> None:
        self._server = server
        self._faces: dict[int, dict[object, _Face]] = {}
        self._count = 0

    def draw(self, texts: Mapping[object, tuple[Text, Transform]], fixed: Transform) -> None:
        """Show these texts, each at a pose in the fixed frame, and no others; `fixed` is the pose
        of the fixed frame in the scene of viser.
        """
        clients = self._server.get_clients()
        self._faces = {number: self._faces.get(number, {}) for number in clients}
        for number, faces in self._faces.items():
            self._draw_in(clients[number], faces, texts, fixed)

    def _draw_in(
        self,
        client: Any,
        faces: "dict[object, _Face]",
        texts: Mapping[object, tuple[Text, Transform]],
        fixed: Transform,
    ) -> None:
        for gone in faces.keys() - texts.keys():
            faces.pop(gone).handle.remove()
        new = 0
        wxyz = client.camera.wxyz
        for key, (text, pose) in texts.items():
            face = faces.get(key)
            if face is None or not face.text.is_like(text):
                if new == _MOST_NEW or (face is None and len(faces) >= _MOST_TEXTS):
                    continue
                new += 1
                face = faces[key] = self._made(client.scene, text, face)
            face.handle.position = fixed.apply(pose.xyz)
            face.handle.wxyz = wxyz

    def _made(self, scene: viser.SceneApi, text: Text, former: "_Face | None") -> "_Face":
        if former is None:
            self._count += 1
        # At the place of the former, which viser replaces without a flicker.
        path = f"/texts/{self._count}" if former is None else former.handle.name
        picture = picture_of_text(text.text, text.rgb)
        if picture is None:
            handle: Any = scene.add_label(
                path,
                text.text,
                font_size_mode="scene",
                font_scene_height=text.height_m,
                depth_test=True,
                anchor="center-center",
            )
            return _Face(text, handle)
        height_m, width_m = (
            size_px * text.height_m / picture.letter_px for size_px in picture.rgba.shape[:2]
        )
        # Browsers change a picture without a flicker, and load a model again.
        if text.opacity == 1.0 and former is None:
            model = model_of(picture.rgba, width_m, height_m)
            handle = scene.add_glb(path, model, cast_shadow=False, receive_shadow=False)
            return _Face(text, handle)
        rgba = picture.rgba.copy()
        rgba[..., 3] = (rgba[..., 3] * text.opacity).astype(np.uint8)
        handle = scene.add_image(
            path,
            rgba,
            render_width=width_m,
            render_height=height_m,
            format="png",
            cast_shadow=False,
            receive_shadow=False,
        )
        return _Face(text, handle)


@dataclass
class _Face:
    text: Text
    handle: Any


@dataclass(frozen=True, eq=False)
class TextPicture:
    """Letters with a line around them (H, W, 4); a capital letter is `letter_px` pixels high."""

    rgba: NDArray[np.uint8]
    letter_px: float


@lru_cache(maxsize=512)
def picture_of_text(text: str, rgb: tuple[int, int, int]) -> TextPicture | None:
    """The picture of a text, its lines centred; None if a letter is in no font."""
    font = _font()
    if any(_is_unknown(letter) for letter in set(text) if not letter.isspace()):
        return None
    measured = ImageDraw.Draw(Image.new("L", (1, 1)))
    layout: Any = {"font": font, "stroke_width": _STROKE_PX, "align": "center"}
    left, top, right, bottom = measured.multiline_textbbox((0, 0), text, **layout)
    size = max(1, int(right - left) + 2), max(1, int(bottom - top) + 2)
    shown = Image.new("RGBA", size, (*rgb, 0))
    is_dark = float(np.dot(rgb, (0.3, 0.59, 0.11))) < _DARK
    ImageDraw.Draw(shown).multiline_text(
        (1 - left, 1 - top),
        text,
        fill=(*rgb, 255),
        stroke_fill=(255, 255, 255, 255) if is_dark else (0, 0, 0, 255),
        **layout,
    )
    _, above, _, below = font.getbbox("A")
    whole_px = shown.width
    shown.thumbnail((_MOST_PX, _MOST_PX))
    return TextPicture(np.asarray(shown), float(below - above) * shown.width / whole_px)


def model_of(rgba: NDArray[np.uint8], width_m: float, height_m: float) -> bytes:
    """A glTF of a picture (H, W, 4), its middle at the origin, x to the right and y down.

    Browsers leave its clear parts out: those of an image of viser hide the map below it.
    """
    corners = np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)]) / 2.0
    material = PBRMaterial(  # type: ignore[no-untyped-call]  # trimesh leaves it untyped
        baseColorTexture=Image.fromarray(rgba),
        alphaMode="MASK",
        alphaCutoff=_LEAST_ALPHA,
        doubleSided=True,
    )
    mesh = trimesh.Trimesh(
        corners * (width_m, height_m, 0.0),
        [(0, 2, 1), (0, 3, 2)],
        visual=TextureVisuals(  # type: ignore[no-untyped-call]  # the same
            uv=[(0, 1), (1, 1), (1, 0), (0, 0)], material=material
        ),
        process=False,
    )

    def unlit(tree: dict[str, Any]) -> None:
        tree["extensionsUsed"] = [_UNLIT]
        for each in tree["materials"]:
            each["extensions"] = {_UNLIT: {}}

    scene = trimesh.Scene(mesh)
    return bytes(export_glb(scene, tree_postprocessor=unlit))  # type: ignore[no-untyped-call]


@lru_cache(maxsize=1)
def _font() -> Any:
    for name in _FONTS:
        try:
            return ImageFont.truetype(name, _FONT_PX)
        except OSError:
            continue
    return ImageFont.load_default(_FONT_PX)


@lru_cache(maxsize=2048)
def _is_unknown(letter: str) -> bool:
    """Whether the font draws a letter as one that it does not have."""
    font = _font()
    return bytes(font.getmask(letter)) == bytes(font.getmask("\U0010ffff"))
