"""The files of `tfbus view`, seen in a real Chromium: settings, a robot, pictures."""

import os
import re
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from signal import SIGINT, SIGKILL
from tempfile import TemporaryDirectory
from typing import Any

import pytest

from tests import needs
from tests.buses import eventually
from tests.live_bus import Bus, free_port
from tests.view.pages import PATIENCE_S, Arm, View, start_view


def test_settings_are_saved_and_a_bad_pattern_is_shown(
    bus: Bus, pages: Any, tmp_path: Path
) -> None:
    """The file opens the same view again; a malformed filter changes nothing."""
    path = tmp_path / "view.yaml"
    Arm(bus.node("arm"))
    process, address = start_view(bus, "--settings", str(path))
    view = View(pages.new_page(), address)
    view.wait_for_status("tool", "dynamic")
    view.tab("View")
    view.field("Only").fill("tool(")
    mistake = view.page.get_by_role("alert").filter(has_text="not a regular expression")
    mistake.wait_for()
    view.field("Only").fill("^t")
    mistake.wait_for(state="detached")
    view.page.get_by_role("button", name="Save settings").click()
    eventually(lambda: path.exists() and "only: ^t" in path.read_text(), within_s=PATIENCE_S)
    process.signal(SIGKILL)
    process.wait()

    # On the same port the open page finds it by itself.
    again = bus.start("view", "--port", address.rpartition(":")[2], "--settings", str(path))
    again.wait_for_line(r"View: http://", timeout_s=PATIENCE_S)
    view.tab("Frames")
    view.page.get_by_text("3 hidden by Only '^t'").wait_for()
    assert view.row("base").count() == 0


def test_the_page_says_which_parts_of_a_robot_it_cannot_show(
    bus: Bus, pages: Any, tmp_path: Path
) -> None:
    """Below the tree; the other parts are shown."""
    urdf = tmp_path / "robot.urdf"
    urdf.write_text(
        "<robot name='r'><link name='base'><visual><geometry><box size='1 1 1'/></geometry>"
        "</visual><visual><geometry><mesh filename='package://arm/a.stl'/></geometry></visual>"
        "</link></robot>"
    )
    _, address = start_view(bus, "--urdf", str(urdf))
    Arm(bus.node("arm"))
    view = View(pages.new_page(), address)
    view.wait_for_status("base", "dynamic")
    said = view.page.get_by_role("alert").filter(has_text="of link 'base'")
    assert re.search(r"--package-path .*'arm'", said.inner_text())


@pytest.fixture
def short_path() -> Iterator[Path]:
    """A folder for Chromium's socket, whose path has at most 107 characters."""
    with TemporaryDirectory() as folder:
        yield Path(folder)


@pytest.mark.real
@pytest.mark.parametrize("is_whole_group", [False, True])
def test_ctrl_c_ends_the_browser_too(bus: Bus, is_whole_group: bool, short_path: Path) -> None:
    """Chromium and its children end, whichever processes get the signal, without a picture."""
    pid_file = short_path / "pid"
    chromium = short_path / "chromium"
    chromium.write_text(f'#!/bin/sh\necho $$ > {pid_file}\nexec {needs.program("chromium")} "$@"\n')
    chromium.chmod(0o755)
    process = bus.start(
        "view",
        *("--port", str(free_port())),
        *("--screenshot", str(short_path / "out.png"), "--after", "600"),
        env={"PATH": f"{short_path}:{os.environ['PATH']}", "TMPDIR": str(short_path)},
    )
    # Once this file exists, so do Chromium's own children.
    eventually(lambda: [*short_path.glob("tmp*/DevToolsActivePort")], within_s=PATIENCE_S)
    group = int(pid_file.read_text())
    if is_whole_group:
        os.killpg(process.pid, SIGINT)
    else:
        process.signal(SIGINT)
    assert process.wait() == 128 + SIGINT
    said = [line for line in process.err if "View: http://" not in line]
    assert said == [f"Loading the page for {short_path}/out.png ..."] and process.out == []
    eventually(lambda: not living_in(group))
    assert not [*short_path.glob("tmp*")]


def living_in(group: int) -> list[int]:
    """The processes of a group that have not ended; zombies do not count."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            state, _, its_group = path.read_text().rpartition(")")[2].split()[:3]
            if int(its_group) == group and state not in "ZX":
                found.append(int(path.parent.name))
    return found
