"""The simulator's window on a virtual screen (Xvfb), and its picture without a screen."""

import os
import struct
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from tests import live_bus, needs
from tests.buses import eventually
from tests.simulated_bus import Bus
from tfbus.messages import Color, SetPen, TeleportAbsolute
from tfbus.nodes.turtle.field import SIZE_M, to_pixels
from tfbus.nodes.turtle.window import DisplayError, Window, save_picture
from tfbus.nodes.turtle.world import World

pygame = pytest.importorskip("pygame", reason="needs pygame-ce: the extra sim")

BACKGROUND = (69, 86, 255)
PEN = (179, 184, 255)
GREEN_SHELL = (76, 175, 80)
ORANGE_SHELL = (255, 152, 0)


@dataclass(frozen=True)
class Screen:
    """A virtual screen of the size of the window, which fills it."""

    display: str
    framebuffer: Path

    def pixels(self) -> NDArray[np.uint8]:
        """The pixels of the screen: (rows, columns, 3), red green blue."""
        data = self.framebuffer.read_bytes()
        # XWD, the X window dump: a header of big-endian words, a colour table, then the rows.
        header = struct.unpack(">25I", data[:100])
        header_size, width, height, row_bytes, table_size = (header[at] for at in (0, 4, 5, 12, 19))
        rows = np.frombuffer(data, np.uint8, height * row_bytes, header_size + 12 * table_size)
        blue_green_red = rows.reshape(height, row_bytes // 4, 4)[:, :width, :3]
        return blue_green_red[..., ::-1]

    def shows(self, color: tuple[int, int, int], *, at_least: int = 1) -> bool:
        """Whether at least this many of its pixels have exactly this colour."""
        return count(self.pixels(), color) >= at_least


def count(pixels: NDArray[np.uint8], color: tuple[int, int, int]) -> int:
    return int((pixels == color).all(axis=-1).sum())


def middle(pixels: NDArray[np.uint8], color: tuple[int, int, int]) -> tuple[float, float]:
    """The mean column and row of the pixels of a colour."""
    rows, columns = np.nonzero((pixels == color).all(axis=-1))
    return float(columns.mean()), float(rows.mean())


def read_picture(path: Path) -> NDArray[np.uint8]:
    columns_first = pygame.surfarray.array3d(pygame.image.load(str(path)))
    pixels: NDArray[np.uint8] = columns_first.swapaxes(0, 1)
    return pixels


@pytest.fixture
def screen(tmp_path: Path) -> Iterator[Screen]:
    needs.program("Xvfb")
    number_in, number_out = os.pipe()
    command = ["Xvfb", "-displayfd", str(number_out), "-screen", "0", "500x500x24"]
    server = subprocess.Popen(
        [*command, "-fbdir", str(tmp_path), "-noreset", "-nolisten", "tcp"],
        pass_fds=[number_out],
        stderr=subprocess.DEVNULL,
    )
    os.close(number_out)
    with open(number_in) as number:
        display = number.readline().strip()
    if not display:
        needs.skip("Xvfb", f"it does not start here (exit code {server.wait()})")
    yield Screen(f":{display}", tmp_path / "Xvfb_screen0")
    server.terminate()
    server.wait()


@pytest.fixture
def no_display(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER"):
        monkeypatch.delenv(name, raising=False)


@pytest.fixture
def on_screen(screen: Screen, no_display: None, monkeypatch: pytest.MonkeyPatch) -> Screen:
    monkeypatch.setenv("DISPLAY", screen.display)
    return screen


# The window


@pytest.mark.real
def test_the_window_shows_the_turtle_on_turtlesims_blue(on_screen: Screen) -> None:
    """A new world is turtlesim's blue with a green turtle in the middle and its name below."""
    with Window("test") as window:
        window.show(World().snapshot())
        pixels = on_screen.pixels()
    assert count(pixels, BACKGROUND) > 0.98 * 500 * 500
    assert middle(pixels, GREEN_SHELL) == pytest.approx((249.5, 249.5), abs=1.5)
    below = pixels[275:290, 220:280]
    assert count(below, (255, 255, 255)) > 30


@pytest.mark.real
def test_the_window_shows_trails_in_the_colour_of_the_pen(on_screen: Screen) -> None:
    """A trail follows the turtle, in its pen's colour and width."""
    world = World()
    turtle = world.turtles["turtle1"]
    turtle.set_pen(SetPen.Request(255, 0, 0, 5))
    turtle.teleport_absolute(TeleportAbsolute.Request(1.0, turtle.y))
    world.step()
    with Window("test") as window:
        window.show(world.snapshot())
        pixels = on_screen.pixels()
    column = pixels[:, 150]
    assert count(column, (255, 0, 0)) in (4, 5)
    assert np.flatnonzero((column == (255, 0, 0)).all(axis=-1)).mean() == pytest.approx(
        249.5, abs=1.0
    )


@pytest.mark.real
def test_the_window_follows_the_world(on_screen: Screen) -> None:
    """Each snapshot replaces the one before: the turtle is shown where it is now."""
    world = World()
    world.turtles["turtle1"].set_pen(SetPen.Request(off=True))
    with Window("test") as window:
        window.show(world.snapshot())
        world.turtles["turtle1"].teleport_absolute(TeleportAbsolute.Request(2.0, 8.0))
        world.background = Color(0, 0, 0)
        world.step()
        window.show(world.snapshot())
        pixels = on_screen.pixels()
    assert middle(pixels, GREEN_SHELL) == pytest.approx(to_pixels(2.0, 8.0), abs=1.5)
    assert count(pixels, BACKGROUND) == 0


@pytest.mark.real
def test_the_window_closes_when_the_user_closes_it(on_screen: Screen) -> None:
    """After the desktop's close button the window is gone, and showing more does nothing."""
    with Window("test") as window:
        window.show(World().snapshot())
        pygame.event.post(pygame.event.Event(pygame.QUIT))
        window.show(World().snapshot())
        assert not window.is_open
        window.show(World().snapshot())


@pytest.mark.real
def test_a_window_can_be_opened_again(on_screen: Screen) -> None:
    """A closed window does not hinder the next one."""
    for _ in range(2):
        with Window("test") as window:
            window.show(World().snapshot())
            assert on_screen.shows(GREEN_SHELL, at_least=100)


def test_without_a_display_there_is_no_window(no_display: None) -> None:
    """One sentence says so."""
    with pytest.raises(DisplayError, match="no display; set DISPLAY"):
        Window("test")


def test_a_display_that_does_not_answer_is_no_display(
    no_display: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A wrong DISPLAY is an error, instead of a window in memory."""
    monkeypatch.setenv("DISPLAY", ":59999")
    with pytest.raises(DisplayError, match="display"):
        Window("test")


# The picture


@pytest.mark.parametrize("heading", range(0, 360, 45))
def test_the_picture_shows_the_heading(heading: int, tmp_path: Path) -> None:
    """The turtle's head, the part of its skin farthest out, points along its heading."""
    world = World()
    world.turtles["turtle1"].teleport_absolute(
        TeleportAbsolute.Request(SIZE_M / 2, SIZE_M / 2, np.radians(heading))
    )
    world.step()
    save_picture(world.snapshot(), tmp_path / "turtle.png")
    pixels = read_picture(tmp_path / "turtle.png")
    ahead = np.radians(heading)
    x, y = to_pixels(SIZE_M / 2 + 0.45 * np.cos(ahead), SIZE_M / 2 + 0.45 * np.sin(ahead))
    head = pixels[round(y) - 2 : round(y) + 3, round(x) - 2 : round(x) + 3]
    assert count(head, (174, 213, 129)) >= 5


def test_turtles_differ_in_colour(tmp_path: Path) -> None:
    """turtle1 is green and turtle2 orange, in every run."""
    world = World()
    world.spawn(2.0, 2.0, 0.0)
    save_picture(world.snapshot(), tmp_path / "turtles.png")
    pixels = read_picture(tmp_path / "turtles.png")
    assert count(pixels, GREEN_SHELL) > 100
    assert middle(pixels, ORANGE_SHELL) == pytest.approx(to_pixels(2.0, 2.0), abs=1.5)


def test_a_name_stays_in_the_picture(tmp_path: Path) -> None:
    """In a corner a long name is moved until all of it shows."""
    whites = []
    for x, y in ((SIZE_M / 2, SIZE_M / 2), (SIZE_M, 0.0), (0.0, SIZE_M)):
        world = World()
        world.kill("turtle1")
        world.spawn(x, y, 0.0, "a_turtle_with_a_long_name")
        save_picture(world.snapshot(), tmp_path / "name.png")
        whites.append(count(read_picture(tmp_path / "name.png"), (255, 255, 255)))
    assert whites == pytest.approx([whites[0]] * 3, abs=20)  # the eyes are white as well
    assert whites[0] > 200


def test_a_picture_that_cannot_be_written_is_an_error(tmp_path: Path) -> None:
    """A missing folder is named in one sentence."""
    with pytest.raises(DisplayError, match=r"write .*no_folder/a\.png"):
        save_picture(World().snapshot(), tmp_path / "no_folder" / "a.png")


# The process


@pytest.mark.real
def test_the_simulator_opens_a_window_and_ends_with_it(bus: live_bus.Bus, screen: Screen) -> None:
    """`tfbus simulator` shows its world; Ctrl-C closes the window, with exit code 0."""
    simulator = bus.start("simulator", env={"DISPLAY": screen.display})
    simulator.wait_for_line("ready")
    eventually(lambda: screen.shows(GREEN_SHELL, at_least=100))

    def done(*arguments: str) -> bool:
        # On a busy machine a tool may not find the simulator in its time.
        return bus.run(*arguments).returncode == 0

    eventually(lambda: done("call", "turtle1/teleport_absolute", "{x: 2.0, y: 2.0}"))
    eventually(lambda: screen.shows(PEN, at_least=300))
    eventually(lambda: done("param", "set", "/sim", "background_r", "200"))
    eventually(lambda: screen.shows((200, 86, 255), at_least=200_000))
    assert simulator.stop() == 0
    assert "Traceback" not in "\n".join(simulator.err)


def test_the_simulator_runs_without_a_display(bus: Bus, tmp_path: Path) -> None:
    """Without a display one line says why there is no window; the rest works."""
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER"):
        bus.env.pop(name, None)
    picture = tmp_path / "field.png"
    simulator = bus.start("simulator", "--screenshot", str(picture))
    simulator.wait_for_line("No window: no display")
    assert bus.run("call", "spawn", "{x: 2, y: 2}").returncode == 0
    assert simulator.stop() == 0
    assert count(read_picture(picture), ORANGE_SHELL) > 100
