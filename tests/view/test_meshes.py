"""The meshes that a URDF names, as `tfbus view` reads them: also strangers'."""

import json
import re
import struct
import threading
import zipfile
import zlib
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("viser", reason="needs viser: the extra view")

from tests.buses import eventually
from tfbus import InvalidNameError
from tfbus.testing.network import Network
from tfbus.view.meshes.loader import FairTurns, MeshLoader, MeshReader, MeshSource, ReadMesh
from tfbus.view.meshes.mesh import MeshError, MeshPart, MeshRequest, bounds_of
from tfbus.view.meshes.read import References, answer, read_mesh, with_creases

# A corner of a box: a triangle 1 m wide and 2 m high.
TRIANGLE = b"""solid corner
 facet normal 0 0 1
  outer loop
   vertex 0 0 0
   vertex 1 0 0
   vertex 0 2 0
  endloop
 endfacet
endsolid
"""

OBJ = b"""mtllib colors.mtl
v 0 0 0
v 1 0 0
v 0 1 0
v 0 0 1
usemtl red
f 1 2 3
usemtl glass
f 1 2 4
"""
MTL = b"newmtl red\nKd 1 0 0\nnewmtl glass\nKd 0 0.5 0\nd 0.5\n"


def box(kind: str) -> bytes:
    """A box of 1 m, 2 m and 3 m."""
    trimesh: Any = pytest.importorskip("trimesh")
    data = trimesh.creation.box((1.0, 2.0, 3.0)).export(file_type=kind)
    return data.encode() if isinstance(data, str) else bytes(data)


def extents(parts: list[MeshPart]) -> list[float]:
    """The sides of the box around parts."""
    low, high = bounds_of(parts)
    return [round(float(side), 6) for side in high - low]


def glb(header: dict[str, Any]) -> bytes:
    """A GLB file of this description alone."""
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 4)
    chunk = struct.pack("<II", len(text), 0x4E4F534A) + text
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunk)) + chunk


@pytest.mark.parametrize("kind", ["stl", "obj", "ply", "off", "glb"])
def test_a_mesh_of_each_kind_has_its_size_and_no_colour_of_its_own(kind: str) -> None:
    """So it gets that of the URDF."""
    parts = read_mesh(kind, box(kind), References())
    assert extents(parts) == [1.0, 2.0, 3.0]
    assert [(part.color, part.textured) for part in parts] == [(None, b"")]


def test_a_mesh_of_collada_is_read_in_its_unit() -> None:
    """With pycollada installed, centimetres become metres."""
    pytest.importorskip("collada", reason="needs pycollada: the extra robot")
    data = box("dae").replace(b"<asset>", b'<asset><unit name="cm" meter="0.01"/>', 1)
    assert extents(read_mesh("dae", data, References())) == [0.01, 0.02, 0.03]


@pytest.mark.parametrize(
    ("axis", "size"),
    [("X", [0.02, 0.03, 0.01]), ("Y", [0.01, 0.03, 0.02]), ("Z", [0.01, 0.02, 0.03])],
)
def test_the_up_axis_of_a_dae_turns_it_where_that_is_asked_for(
    axis: str, size: list[float]
) -> None:
    """What is up in the file is z then; without it the file is as RViz has it."""
    plain = re.sub(rb"<up_axis>.*?</up_axis>", b"", box("dae"))
    stated = f'<asset><unit name="cm" meter="0.01"/><up_axis>{axis}_UP</up_axis>'.encode()
    data = plain.replace(b"<asset>", stated, 1)
    assert extents(read_mesh("dae", data, References())) == [0.01, 0.02, 0.03]
    assert extents(read_mesh("dae", data, References(), heeds_up_axis=True)) == size


def test_an_obj_has_a_part_for_each_of_its_materials(tmp_path: Path) -> None:
    """With their colours, and as transparent as they are."""
    (tmp_path / "colors.mtl").write_bytes(MTL)
    parts = read_mesh("obj", OBJ, References(tmp_path, tmp_path))
    looks = {(part.color, part.opacity) for part in parts}
    assert looks == {((255, 0, 0), 1.0), ((0, 128, 0), 0.5)}


def test_a_picture_is_sent_with_the_mesh_and_gives_its_mean_colour() -> None:
    """For browsers that draw it, and for where it is seen through."""
    trimesh: Any = pytest.importorskip("trimesh")
    from PIL import Image

    mesh = trimesh.creation.box((1.0, 1.0, 1.0))
    picture = Image.new("RGB", (8, 8), (200, 100, 50))
    mesh.visual = trimesh.visual.TextureVisuals(uv=np.zeros((8, 2)), image=picture)
    [part] = read_mesh("glb", mesh.export(file_type="glb"), References())
    assert part.color == pytest.approx((200, 100, 50), abs=4)
    assert part.textured.startswith(b"glTF")


PLAIN_OBJ = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\n"
NO_PLACE = "the mesh has no texture coordinates, or a look of its own"


def png(color: tuple[int, int, int]) -> bytes:
    """A picture of this colour."""
    image: Any = pytest.importorskip("PIL.Image")
    out = BytesIO()
    image.new("RGB", (4, 4), color).save(out, "PNG")
    return out.getvalue()


@pytest.mark.parametrize(
    ("kind", "data", "picture", "color", "said"),
    [
        ("obj", PLAIN_OBJ, png((9, 9, 200)), (9, 9, 200), ""),
        ("obj", PLAIN_OBJ, b"", None, "it is not a picture"),
        ("obj", b"mtllib a.mtl\nusemtl x\n" + PLAIN_OBJ, png((9, 9, 200)), (255, 0, 0), NO_PLACE),
        ("obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", png((9, 9, 200)), None, NO_PLACE),
        ("stl", TRIANGLE, png((9, 9, 200)), None, NO_PLACE),
    ],
)
def test_a_picture_of_the_urdf_is_drawn_where_the_mesh_has_a_place_for_it(
    kind: str, data: bytes, picture: bytes, color: tuple[int, int, int] | None, said: str
) -> None:
    """What the mesh says of its look goes first; why it is not drawn is said."""
    references = References(beside={"a.mtl": b"newmtl x\nKd 1 0 0\n"})
    [part] = read_mesh(kind, data, references, ("wood.png", picture))
    assert part.color == color
    assert part.textured.startswith(b"glTF") is (not said)
    assert references.refused == ({"wood.png": said} if said else {})


def test_a_mesh_is_drawn_without_a_picture_that_is_a_bomb() -> None:
    """It has no colour, and why is said: no robot has a picture of 60,000 by 60,000 pixels."""
    picture = bytearray(png((9, 9, 200)))
    header = b"IHDR" + struct.pack(">II", 60_000, 60_000) + picture[24:29]
    picture[12:33] = header + struct.pack(">I", zlib.crc32(header))
    references = References()
    [part] = read_mesh("obj", PLAIN_OBJ, references, ("wood.png", bytes(picture)))
    assert part.color is None
    assert "pixels" in references.refused["wood.png"]


def test_a_mesh_with_texture_coordinates_and_no_picture_has_no_colour_of_its_own() -> None:
    """The colour of the URDF is drawn, and not a grey that its reader makes up."""
    [part] = read_mesh("obj", PLAIN_OBJ, References())
    assert (part.color, part.textured) == (None, b"")


def test_the_picture_of_the_urdf_comes_from_the_machine_of_the_mesh(
    loaders: type[MeshLoader], tmp_path: Path
) -> None:
    """Of each machine; one that is not there is named, and the mesh is shown without it."""
    (tmp_path / "a.obj").write_bytes(PLAIN_OBJ)
    (tmp_path / "wood.png").write_bytes(png((9, 9, 200)))
    machine = Machine({"a.obj": PLAIN_OBJ, "wood.png": png((200, 9, 9))})
    here, wood = tmp_path / "a.obj", tmp_path / "wood.png"
    found = {
        MeshSource("a.obj", here, tmp_path, texture="wood.png", texture_path=wood): (9, 9, 200),
        MeshSource("a.obj", here, tmp_path, texture="no.png"): None,
        MeshSource("a.obj", here, tmp_path): None,
        MeshSource("a.obj", origin="robot7", texture="wood.png"): (200, 9, 9),
        MeshSource("a.obj", origin="robot7", texture="no.png"): None,
    }
    loader = loaders(machine.fetch)
    try:
        for source, color in found.items():
            loader.load(source)
            eventually(lambda source=source: loader.found(source) is not None)
            mesh = loader.found(source)
            assert isinstance(mesh, ReadMesh)
            assert [part.color for part in mesh.parts] == [color]
            assert list(mesh.refused) == (["no.png"] if source.texture == "no.png" else [])
    finally:
        loader.close()


def test_a_material_outside_of_the_package_is_not_read(tmp_path: Path) -> None:
    """The mesh is there without it, and it is named."""
    (tmp_path / "arm").mkdir()
    (tmp_path / "colors.mtl").write_bytes(MTL)
    references = References(tmp_path / "arm", tmp_path / "arm")
    outside = OBJ.replace(b"colors.mtl", b"../colors.mtl")
    parts = read_mesh("obj", outside, references)
    assert [part.color for part in parts] == [None]
    assert list(references.refused) == ["../colors.mtl"]
    assert "outside" in references.refused["../colors.mtl"]


def test_only_pictures_materials_and_buffers_are_read_beside_a_mesh(tmp_path: Path) -> None:
    """Whatever a mesh names, no other file of the machine is opened."""
    (tmp_path / "id_rsa").write_bytes(b"secret")
    references = References(tmp_path, tmp_path)
    with pytest.raises(FileNotFoundError):
        references.get("id_rsa")
    assert list(references.refused) == ["id_rsa"]
    assert "picture, material or buffer" in references.refused["id_rsa"]


def zipped() -> bytes:
    """A ZIP archive with a DAE."""
    with BytesIO() as file:
        with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr("bomb.dae", b"\0" * 1_000_000)
        return file.getvalue()


BOMB = b'<!DOCTYPE c [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;">]><COLLADA>&b;</COLLADA>'


@pytest.mark.parametrize(
    ("kind", "data", "said"),
    [
        ("dae", zipped(), "it is a ZIP archive, not XML"),
        ("dae", BOMB, "its DOCTYPE declares entities"),
        ("dae", b'<!DOCTYPE c [<!ATTLIST a b CDATA "c">]><COLLADA/>', "its DOCTYPE declares"),
        ("dae", BOMB.decode().encode("utf-16"), "its DOCTYPE declares entities"),
        ("dae", b"not xml", "it is not XML: syntax error: line 1, column 0"),
        ("glb", b"not a glb", "it is not a GLB file"),
        ("glb", glb({"accessors": [{"count": 10**12}]}), "it has more than 2,000,000 triangles"),
        ("glb", glb({"nodes": [{"children": [1]}, {"children": [1]}]}), "two parents"),
        ("gltf", b"[1]", "its description is not a JSON object"),
        ("stl", b"\0" * 80 + struct.pack("<I", 10**9), "it is cut short"),
        ("stl", b"", "it is empty"),
        ("blend", b"BLENDER", "no reader for .blend"),
    ],
)
def test_a_file_that_would_harm_a_reader_is_refused(kind: str, data: bytes, said: str) -> None:
    """Before the reader gets it, in one sentence."""
    with pytest.raises(MeshError, match=said):
        read_mesh(kind, data, References())


def test_vertices_are_shared_along_smooth_edges_and_not_along_sharp_ones() -> None:
    """A browser shades by vertices: each side of a box needs its own, a sphere does not."""
    trimesh: Any = pytest.importorskip("trimesh")
    for mesh, count in (
        (trimesh.creation.box(), 24),
        (trimesh.creation.icosphere(subdivisions=3), 642),
    ):
        loose = np.asarray(mesh.triangles, np.float32).reshape(-1, 3)
        faces = np.arange(len(loose), dtype=np.uint32).reshape(-1, 3)
        vertices, corners = with_creases(loose, faces)
        assert len(vertices) == count
        assert np.array_equal(vertices[corners], loose[faces])


# The process that reads


@pytest.mark.real
def test_meshes_are_read_in_another_process_that_starts_again(tmp_path: Path) -> None:
    """A file that cannot be read does not end it, and after its end the next file is read."""
    good, bad = tmp_path / "good.stl", tmp_path / "bad.stl"
    good.write_bytes(TRIANGLE)
    bad.write_bytes(b"solid nothing")
    reader = MeshReader()
    try:
        with pytest.raises(MeshError):
            reader.read(MeshRequest("stl", bad, tmp_path))
        first = reader.read(MeshRequest("stl", good, tmp_path))
        reader.rest()
        second = reader.read(MeshRequest("stl", good, tmp_path))
        assert extents([*first.parts]) == extents([*second.parts]) == [1.0, 2.0, 0.0]
    finally:
        reader.close()


class ReadsHere(MeshReader):
    """Reads as that process does, in this one."""

    def _process_now(self) -> Any:
        return None

    def _answer(self, process: Any, request: MeshRequest | None, within_s: float) -> Any:
        return answer(request.as_map()) if request else {"ready": True}


@pytest.fixture
def loaders(network: Network, monkeypatch: pytest.MonkeyPatch) -> type[MeshLoader]:
    """Loaders of meshes, in virtual time and without that process."""
    monkeypatch.setattr("tfbus.view.meshes.loader.MeshReader", ReadsHere)
    return MeshLoader


class Machine:
    """Another machine with mesh files, that counts what is fetched."""

    def __init__(self, files: dict[str, bytes]) -> None:
        self.files = files
        self.fetched: list[str] = []

    def fetch(self, origin: str, name: str, within_s: float) -> bytes:
        """A file of it."""
        self.fetched.append(name)
        if name not in self.files:
            raise MeshError(f"{origin} has no {name}")
        return self.files[name]


def test_a_mesh_of_another_machine_comes_with_its_materials_and_once(
    loaders: type[MeshLoader],
) -> None:
    """They are asked for by their names beside it."""
    machine = Machine({"package://arm/a.obj": OBJ, "package://arm/colors.mtl": MTL})
    loader = loaders(machine.fetch)
    source = MeshSource("package://arm/a.obj", origin="robot7")
    try:
        loader.load(source)
        loader.load(source)
        eventually(lambda: loader.found(source) is not None)
        mesh = loader.found(source)
        assert isinstance(mesh, ReadMesh)
        assert {part.color for part in mesh.parts} == {(255, 0, 0), (0, 128, 0)}
        assert machine.fetched == ["package://arm/a.obj", "package://arm/colors.mtl"]
    finally:
        loader.close()


def test_a_mesh_of_another_machine_names_no_file_of_this_one(
    loaders: type[MeshLoader], tmp_path: Path
) -> None:
    """Neither by a path from the root nor by one that leads out."""
    secret = tmp_path / "colors.mtl"
    secret.write_bytes(MTL)
    machine = Machine({"a.obj": OBJ.replace(b"colors.mtl", str(secret).encode())})
    loader = loaders(machine.fetch)
    source = MeshSource("a.obj")
    try:
        loader.load(source)
        eventually(lambda: loader.found(source) is not None)
        mesh = loader.found(source)
        assert isinstance(mesh, ReadMesh)
        assert [part.color for part in mesh.parts] == [None]
        assert machine.fetched == ["a.obj"]
    finally:
        loader.close()


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (InvalidNameError("service 'my robot' has a space"), "service 'my robot' has a space"),
        (OSError(12, "Cannot allocate memory"), "it cannot be read: Cannot allocate memory"),
    ],
)
def test_a_mesh_that_cannot_be_had_says_why_and_the_next_one_is_loaded(
    loaders: type[MeshLoader], error: Exception, said: str
) -> None:
    """Whichever way it fails: on the bus, or because the reader cannot start."""

    def fetch(origin: str, name: str, within_s: float) -> bytes:
        if name == "bad.stl":
            raise error
        return TRIANGLE

    loader = loaders(fetch)
    bad, good = MeshSource("bad.stl", origin="robot7"), MeshSource("good.stl", origin="robot7")
    try:
        loader.load(bad)
        loader.load(good)
        assert isinstance(eventually(lambda: loader.found(good)), ReadMesh)
        assert loader.found(bad) == said
    finally:
        loader.close()


# Turns


def test_those_who_used_least_time_go_first() -> None:
    """Whoever comes anew begins where the last turn was, by whatever name."""
    turns: FairTurns[str] = FairTurns()
    for sender, items in {"slow": "abc", "quick": "xyz"}.items():
        for item in items:
            turns.add(sender, item)
    taken = ""
    while following := turns.next():
        sender, item = following
        taken += item
        turns.use(sender, 5.0 if sender == "slow" else 0.1)
        if item == "b":
            turns.add("fresh", "f")
    assert taken == "axyzbfc"
    turns.add("quick", "1")
    turns.add("slow", "2")
    turns.keep(lambda item: item != "2")
    assert turns.next() == ("quick", "1") and turns.next() is None


def test_a_file_that_takes_long_holds_up_no_other(
    loaders: type[MeshLoader], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The slow file makes way, is read beside the others, and ends in its own time, with why."""
    monkeypatch.setattr("tfbus.view.meshes.loader._MAKES_WAY_S", 0.5)
    may_end = threading.Event()

    def fetch(origin: str, name: str, within_s: float) -> bytes:
        if name == "bad.stl":
            may_end.wait(within_s)
            raise MeshError("it came too slowly")
        return TRIANGLE

    loader = loaders(fetch)
    bad = MeshSource("bad.stl", origin="bad")
    good = [MeshSource(f"good{n}.stl", origin="good") for n in range(3)]
    try:
        loader.load(bad, "bad")
        for source in good:
            loader.load(source, "good")
        for source in good:
            assert isinstance(eventually(lambda source=source: loader.found(source)), ReadMesh)
        assert loader.found(bad) is None
        may_end.set()
        assert eventually(lambda: loader.found(bad)) == "it came too slowly"
    finally:
        loader.close()


@pytest.mark.real
def test_reading_ends_after_its_time(tmp_path: Path) -> None:
    """Though the file is small, and its reader goes on."""
    reader = MeshReader()
    try:
        with pytest.raises(MeshError, match="took more than 0 s"):
            reader.read(MeshRequest("stl", data=TRIANGLE * 100_000), 0.0)
        assert reader.read(MeshRequest("stl", data=TRIANGLE)).parts
    finally:
        reader.close()
