"""The page for a buffer of a program: it follows the buffer, and draws the program's shapes."""

import subprocess
import sys
from collections.abc import Callable, Iterator
from functools import partial
from io import BytesIO, StringIO
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
import rich.console

from tests import needs
from tests.builders import S, moved
from tests.buses import DEADLINE_S
from tests.live_bus import free_port
from tests.view.pages import View as Page
from tests.view.pages import eventually
from tfbus import Buffer, InvalidArgumentException, Transform
from tfbus.base.installation import install_command
from tfbus.view import View, show
from tfbus.view.scene.drawn import FIXED_NODE

PICTURE = np.zeros((4, 6, 3), np.uint8)


@pytest.fixture
def buffer() -> Buffer:
    """A base in the map, as it was recorded long ago."""
    filled = Buffer()
    filled.set_transform(moved(1 * S, "map", "base", 1.0))
    filled.set_transform(moved(2 * S, "map", "base", 2.0))
    return filled


@pytest.fixture
def served(
    real: None, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest
) -> list[Any]:
    """The pages that `show` makes; in a test with steps of its own they make none."""
    pytest.importorskip("viser", reason="needs viser: the extra view")
    from tfbus.view import local, page

    made: list[Any] = []

    class Noted(page.Page):
        def __init__(self, *given: Any, **more: Any) -> None:
            super().__init__(*given, **more)
            made.append(self)

        def run(self) -> None:
            if "step" not in request.fixturenames:
                super().run()

    monkeypatch.setattr(local, "Page", Noted)
    return made


@pytest.fixture
def view(served: list[Any], buffer: Buffer) -> Iterator[View]:
    """The page of that buffer."""
    with show(buffer, port=free_port(), rate_hz=5.0) as shown:
        yield shown


@pytest.fixture
def page(view: View, served: list[Any]) -> Any:
    """The page behind the view."""
    [page] = served
    return page


@pytest.fixture
def step(page: Any, buffer: Buffer) -> Callable[[], None]:
    """Bring the shapes up to date, as the page does for a browser."""

    def draw() -> None:
        from tfbus.view.frames import place

        page.drawn.draw(place(buffer, "map", buffer.frames(), None), Transform())

    return draw


ADDERS: dict[str, Callable[[View], None]] = {
    "points": lambda view: view.add_points("a", "base", [(0, 0, 0), (1, np.nan, 0)]),
    "colored points": lambda view: view.add_points("a", "base", [(0, 0, 0)], color=[(9, 9, 9)]),
    "a line": lambda view: view.add_lines("a", "base", [(0, 0, 0), (1, 0, 0), (1, 1, 0)]),
    "lines": lambda view: view.add_lines("a", "base", [[(0, 0, 0), (1, 0, 0)]]),
    "an arrow": lambda view: view.add_arrow("a", "base", (0, 0, 0), (1, 0, 0)),
    "a box": lambda view: view.add_box("a", "base", (1, 2, 3), pose=Transform((1, 0, 0))),
    "a sphere": lambda view: view.add_sphere("a", "base", 0.5, opacity=0.5),
    "a text": lambda view: view.add_text("a", "base", "<b>here</b>"),
    "a camera": lambda view: view.add_camera("a", "base", fov_y_rad=0.8),
    "a camera's picture": lambda view: view.add_camera(
        "a", "base", camera_matrix=np.diag((5, 5, 1)), image=PICTURE
    ),
    "an image": lambda view: view.add_image("a", "base", PICTURE[:, :, 0], 1.0),
}


@pytest.mark.parametrize("kind", ADDERS)
def test_a_shape_moves_with_its_frame(
    kind: str, view: View, page: Any, buffer: Buffer, step: Callable[[], None]
) -> None:
    """Each kind is where its frame is; it is replaced by its name, and removed."""
    ADDERS[kind](view)
    ADDERS[kind](view)
    step()
    assert page.drawn.shapes["a"].node.position.tolist() == [2.0, 0.0, 0.0]
    buffer.set_transform(moved(3 * S, "map", "base", 3.0))
    step()
    assert page.drawn.shapes["a"].node.position.tolist() == [3.0, 0.0, 0.0]
    assert page.drawn.shapes["a"].node.visible
    view.remove("a")
    assert not page.drawn.shapes


@pytest.mark.parametrize("pose", [(1.0, 2.0, 3.0), Transform((1, 2, 3))], ids=["point", "pose"])
@pytest.mark.parametrize("kind", ["box", "sphere", "text", "image"])
def test_a_shape_is_at_a_pose_or_a_point_of_its_frame(
    kind: str, pose: object, view: View, page: Any
) -> None:
    """By one name for all kinds."""
    arguments = {"box": [(1, 1, 1)], "sphere": [0.5], "text": ["here"], "image": [PICTURE, 1.0]}
    getattr(view, f"add_{kind}")("a", "base", *arguments[kind], pose=pose)
    shape = page.drawn.shapes["a"]
    at = shape.handle.position if shape.at is None else shape.at
    assert at.tolist() == [1.0, 2.0, 3.0]
    with pytest.raises(InvalidArgumentException, match="pose: expected 3"):
        getattr(view, f"add_{kind}")("a", "base", *arguments[kind], pose=(1, 2))


def test_a_label_is_where_its_frame_is_in_the_picture(buffer: Buffer) -> None:
    """Also while cameras follow a frame: then the fixed frame moves, and no label is below it."""
    from tfbus.view.frames import place
    from tfbus.view.scene.drawn import FIXED_NODE, Drawn

    there = {}

    def add_label(path: str, text: str, **shape: Any) -> Any:
        assert not path.startswith(FIXED_NODE)
        there[path] = SimpleNamespace(text=text, remove=lambda: there.pop(path), **shape)
        return there[path]

    drawn = Drawn(cast(Any, SimpleNamespace(add_label=add_label)))
    drawn.add_label("goal", "map", "former", np.zeros(3))
    drawn.add_label("goal", "base", "goal_pose", np.array((0.0, 0.0, 0.5)))
    fixed = Transform.from_rpy(0.0, 0.0, np.pi / 2, xyz=(10.0, 0.0, 0.0))
    drawn.draw(place(buffer, "map", buffer.frames(), None), fixed)
    [label] = there.values()
    assert (label.text, label.visible) == ("goal_pose", True)
    assert label.position == pytest.approx((10.0, 2.0, 0.5))
    assert drawn.remove("goal")
    assert not there


def test_a_shape_of_a_frame_that_is_not_there_waits_for_it(
    view: View, page: Any, buffer: Buffer, step: Callable[[], None]
) -> None:
    """It is hidden until the frame has a place."""
    view.add_sphere("ball", "hand", 0.1)
    step()
    assert not page.drawn.shapes["ball"].node.visible
    buffer.set_transform(moved(2 * S, "base", "hand"), static=True)
    step()
    assert page.drawn.shapes["ball"].node.visible


@pytest.mark.parametrize(
    ("add", "said"),
    [
        (lambda view: view.add_points("a", "/map", [(0, 0, 0)]), "begins with a slash"),
        (lambda view: view.add_points("a", "map", [0, 0, 0]), "expected shape (N, 3)"),
        (lambda view: view.add_points("a", "map", [(0, 0, 0)], color=(0, 0, 256)), "0 to 255"),
        (lambda view: view.add_points("a", "map", [(0, 0, 0)], color=(0.5, 0, 0)), "integers"),
        (lambda view: view.add_lines("a", "map", [(0, 0, 0), (0, 0, np.inf)]), "finite"),
        (lambda view: view.add_arrow("a", "map", (0, 0), (1, 0, 0)), "start: expected 3"),
        (lambda view: view.add_box("a", "map", (1, 0, 1)), "above 0"),
        (lambda view: view.add_sphere("a", "map", 1.0, opacity=2.0), "opacity"),
        (lambda view: view.add_camera("a", "map", fov_y_rad=4.0), "from 0 to pi"),
        (lambda view: view.add_camera("a", "map", camera_matrix=np.eye(3)), "needs size_px"),
        (lambda view: view.add_image("a", "map", np.zeros((2, 2, 3)), 1.0), "uint8"),
        (lambda view: view.remove("a"), "no shape 'a'"),
    ],
)
def test_what_cannot_be_drawn_is_refused(
    add: Callable[[View], None], said: str, view: View, page: Any
) -> None:
    """In one sentence, and nothing is drawn."""
    with pytest.raises(InvalidArgumentException) as raised:
        add(view)
    assert said in str(raised.value)
    assert not page.drawn.shapes


def test_a_shape_that_cannot_be_made_changes_nothing(view: View, page: Any) -> None:
    """The shape of that name stays; a new one leaves nothing behind in the scene."""

    def fail(path: str) -> Any:
        raise ValueError(path)

    def nodes() -> set[str]:
        names = list(page.server.scene._handle_from_node_name)
        return {name for name in names if name.startswith(f"{FIXED_NODE}/drawn/")}

    view.add_sphere("ball", "base", 0.1)
    before, nodes_before = page.drawn.shapes["ball"], nodes()
    for name in ("ball", "new"):
        with pytest.raises(ValueError, match="/shape"):
            page.drawn.add(name, "tool", fail)
    assert page.drawn.shapes == {"ball": before}
    assert nodes() == nodes_before


def test_a_notebook_shows_the_page(view: View) -> None:
    """In a frame below the cell, with a link."""
    assert f'<iframe src="{view.url}"' in view._repr_html_()


@pytest.mark.real
def test_the_server_says_nothing(buffer: Buffer, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither when it starts nor when it stops, also on a console that is not standard output, as
    that of a notebook.
    """
    console = rich.console.Console(file=StringIO())
    monkeypatch.setattr(rich, "_console", console)
    show(buffer, port=free_port()).close()
    assert console.file.getvalue() == ""  # type: ignore[attr-defined]
    assert not console.quiet


@pytest.mark.real
def test_a_page_for_other_machines_must_be_public(buffer: Buffer) -> None:
    """Then its address has a token, and a notebook a link: no frame would get the cookie."""
    needs.module("cryptography")
    with pytest.raises(InvalidArgumentException, match="add public=True"):
        show(buffer, host="0.0.0.0")
    with show(buffer, host="0.0.0.0", public=True, port=free_port()) as view:
        assert view.url.startswith("https://") and "/?token=" in view.url
        assert "<iframe" not in view._repr_html_() and view.url in view._repr_html_()


_WITHOUT_VISER = """
import sys
sys.modules["viser"] = None
import tfbus, tfbus.view
try:
    tfbus.view.show(tfbus.Buffer())
except tfbus.TfbusError as error:
    print(error)
"""


@pytest.mark.real
def test_without_viser_the_remedy_is_named() -> None:
    """It is the command that installs the extra."""
    ended = subprocess.run(
        [sys.executable, "-c", _WITHOUT_VISER],
        capture_output=True,
        text=True,
        timeout=2 * DEADLINE_S,
    )
    assert ended.stdout.startswith("viser is not installed")
    assert ended.stdout.rstrip().endswith(install_command("view"))


def test_a_second_view_takes_the_next_port(buffer: Buffer, view: View) -> None:
    """Both are there until they are closed; twice is fine."""
    port = int(view.url.rpartition(":")[2])
    other = show(buffer, port=port)
    assert other.url != view.url
    other.close()
    other.close()


@pytest.mark.real
def test_a_program_ends_with_its_view_open() -> None:
    """A view does not keep the process alive."""
    pytest.importorskip("viser", reason="needs viser: the extra view")
    code = f"import tfbus.view; tfbus.view.show(tfbus.Buffer(), port={free_port()})"
    ended = subprocess.run(
        [sys.executable, "-c", f"import tfbus; {code}"],
        capture_output=True,
        text=True,
        timeout=2 * DEADLINE_S,
    )
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, "", "")


def red_share(page: Page) -> float:
    """How much of the page is red."""
    image = needs.module("PIL.Image").open(BytesIO(page.page.screenshot())).convert("RGB")
    r, g, b = np.moveaxis(np.asarray(image).astype(int), -1, 0)
    return float(np.mean((r > 120) & (g < 60) & (b < 60)))


def look_at_of_one(page: Any) -> Any:
    """The point that the camera of the only browser looks at."""
    (client,) = page.server.get_clients().values()
    return client.camera.look_at


def test_a_browser_shows_a_recording_and_what_is_drawn(
    buffer: Buffer, view: View, served: list[Any], pages: Any
) -> None:
    """An old recording is not stale, a ball is seen, and the camera goes where it is sent."""
    page = Page(pages.new_page(), view.url)
    page.headline("2 frames, seen from map")
    page.wait_for_status("base", "dynamic")
    buffer.set_transform(moved(2 * S, "base", "tool"), static=True)
    page.headline("3 frames, seen from map")
    before = red_share(page)
    view.add_sphere("ball", "base", 0.6, color=(255, 0, 0))
    eventually(lambda: red_share(page) > before + 0.002)
    view.clear()
    eventually(lambda: red_share(page) < before + 0.002)
    assert page.page.title() == "tfbus"

    looks_at = partial(look_at_of_one, served[0])
    page.page.keyboard.press("f")
    page.page.get_by_text("Click on a frame first").wait_for()
    page.select("tool")
    page.page.keyboard.press("f")
    eventually(lambda: looks_at() == pytest.approx((2.0, 0.0, 0.0), abs=0.01))
    page.page.get_by_role("button", name="see from here").click()
    page.headline("seen from tool")
    eventually(lambda: looks_at() == pytest.approx((0.0, 0.0, 0.0), abs=0.01))
    page.button("All (H)")
    eventually(lambda: looks_at() == pytest.approx((-1.0, 0.0, 0.0), abs=0.01))
    assert page.errors == []


# The tree's place in the page, and that of the selected row in it: tops and bottoms.
_PLACES = """() => [
  document.querySelector('.tf[role=tree]').parentElement,
  document.querySelector('.tf-selected'),
].map((each) => each && [each.getBoundingClientRect().top, each.getBoundingClientRect().bottom])"""


def test_the_tree_of_frames_has_the_height_of_the_page(
    buffer: Buffer, view: View, pages: Any
) -> None:
    """Down to its end; a row that is selected there stays in sight above its facts."""
    for number in range(60):
        buffer.set_transform(moved(2 * S, "base", f"link_{number:02}"), static=True)
    tab = pages.new_page()
    tab.set_viewport_size({"width": 1280, "height": 1000})
    page = Page(tab, view.url)
    page.headline("62 frames")
    page.row("link_30").wait_for()
    eventually(lambda: 900 < page.page.evaluate(_PLACES)[0][1] < 1000)
    page.row("link_30").get_by_role("button").click()
    page.page.locator(".tf-selected").wait_for()

    def is_in_sight() -> bool:
        (top, bottom), row = page.page.evaluate(_PLACES)
        return bool(bottom < 800 and row and top <= row[0] and row[1] <= bottom + 1)

    eventually(is_in_sight)
