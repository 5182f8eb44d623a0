"""`tfbus top`: its rows, and the screen in a real terminal."""

import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from tests import buses, live_bus, needs
from tests.buses import keep_sending
from tests.simulated_bus import Bus
from tfbus import (
    Buffer,
    StaticTransformBroadcaster,
    Transform,
    TransformStamped,
)
from tfbus.frames.meter import SpanMeter
from tfbus.frames.moment import BusMoment
from tfbus.frames.report import EDGES, EdgeFlow, Report
from tfbus.frames.snapshot import frame_tree
from tfbus.messages import Empty
from tfbus.top.rows import Cell, Row, ScreenTable, chosen, fitting, frames_table, nodes_table
from tfbus.wire.descriptions import DelayDescription, NodeDescription

pytest.importorskip("textual", reason="needs textual: the extra top")


def table(*frames: tuple[str, float | None]) -> ScreenTable:
    rows = [Row(name, (Cell(name, name), Cell.of(rate, ".1f"))) for name, rate in frames]
    return ScreenTable("frames", ("frame", "Hz"), tuple(rows))


def names(rows: list[Row]) -> list[str]:
    return [row.key for row in rows]


class TestRows:
    bus = table(("drone", 60.0), ("camera", None), ("Base", 9.5))

    def test_they_are_sorted_by_any_column(self) -> None:
        """Numbers are sorted as numbers, empty cells last."""
        assert names(chosen(self.bus, "", 1, False)) == ["Base", "drone", "camera"]
        assert names(chosen(self.bus, "", 1, True)) == ["camera", "drone", "Base"]

    def test_numbers_and_words_can_be_in_one_column(self) -> None:
        """A column of numbers can contain a word, such as `static` among rates."""
        rows = (
            *table(("drone", 60.0)).rows,
            Row("fixed", (Cell("fixed", "fixed"), Cell("static", "static"))),
        )
        both = ScreenTable("frames", ("frame", "Hz"), rows)
        assert names(chosen(both, "", 1, False)) == ["drone", "fixed"]

    def test_they_are_filtered_by_words(self) -> None:
        """A row is shown if each word is in one of its cells, in any case."""
        assert names(chosen(self.bus, "ba", 0, False)) == ["Base"]
        assert names(chosen(self.bus, "DRO 60", 0, False)) == ["drone"]
        assert names(chosen(self.bus, "dro base", 0, False)) == []


def test_a_narrow_screen_gives_up_the_least_useful_columns() -> None:
    """The other columns keep their whole width, and one comes back only with room to spare."""
    cells = tuple(Cell(text, text) for text in ("base", "world", "odometry", "20.0"))
    bus = ScreenTable(
        "frames", ("frame", "parent", "stream", "Hz"), (Row("base", cells),), ("stream", "parent")
    )
    all_of_them = 4 * 2 + len("frame") + len("parent") + len("odometry") + len("20.0") + 2 * 2
    assert fitting(bus, bus.rows, all_of_them, range(4)) == [0, 1, 2, 3]
    assert fitting(bus, bus.rows, all_of_them - 1, range(4)) == [0, 1, 3]
    assert fitting(bus, bus.rows, all_of_them + 3, [0, 1, 3]) == [0, 1, 3]
    assert fitting(bus, bus.rows, all_of_them + 4, [0, 1, 3]) == [0, 1, 2, 3]
    assert fitting(bus, bus.rows, 1, range(4)) == [0, 3]


Tmux = Callable[..., str]


def eventually(condition: Callable[[], object]) -> None:
    """Wait until the condition holds, which asks tmux by a process of its own."""
    buses.eventually(condition, every_s=0.1)


@pytest.fixture
def tmux(bus: live_bus.Bus, tmp_path: Path) -> Iterator[Tmux]:
    """`tmux(...)` on a server of the test's own; `tmux("capture-pane", "-p")` is the screen."""
    needs.program("tmux")
    env = {**bus.env, "TMUX_TMPDIR": str(tmp_path), "TERM": "xterm-256color", "LANG": "C.UTF-8"}

    def run(*arguments: str) -> str:
        command = ["tmux", "-f", "/dev/null", *arguments]
        return subprocess.run(command, env=env, capture_output=True, text=True).stdout

    yield run
    run("kill-server")


@pytest.mark.real
def test_the_screen_follows_its_keys(bus: live_bus.Bus, tmux: Tmux) -> None:
    """In a terminal the tabs, the order, the filter and one frame's details are a key away."""
    keep_sending(bus.node("odometry"), "world", "base")
    mount = bus.node("mount")
    mount.create_service(Empty, "reset", lambda request: Empty.Response())
    StaticTransformBroadcaster(mount).send_transform(
        TransformStamped(mount.now_ns(), "base", "camera", Transform.identity())
    )

    chat = bus.node("chatter").create_raw_publisher("chat", type_name="Chat")
    mount.create_timer(0.1, lambda: chat.publish(b"hello"))

    def shows(*texts: str) -> None:
        try:
            eventually(lambda: all(text in tmux("capture-pane", "-p") for text in texts))
        except AssertionError:
            raise AssertionError(
                f"{texts} are not on the screen:\n{tmux('capture-pane', '-p')}"
            ) from None

    tmux(
        "new-session",
        "-d",
        "-x",
        "80",
        "-y",
        "24",
        f"{sys.executable} -m tfbus top; echo left; cat",
    )
    shows("3 frames, 2 streams, 3 nodes, 3 topics, 1 service")
    shows("frame ▲", "odometry", "static", "root", "state")
    tmux("send-keys", "r")
    shows("frame ▼")
    tmux("send-keys", "r", "Enter")
    shows("Publisher: /odometry on", "mean of 10 s")
    tmux("send-keys", "Escape")
    eventually(lambda: "Publisher" not in tmux("capture-pane", "-p"))
    tmux("send-keys", "r")
    shows("frame ▼")
    tmux("send-keys", "2")
    shows("stream ▲", "/odometry", "state")
    tmux("send-keys", "3")
    shows("node ▲", "/mount", "lost")
    tmux("send-keys", "4")
    shows("name ▲", "tf/odometry", "TransformMessage")
    shows("? Help", "q Quit", "m Measure")
    tmux("send-keys", "?")
    shows("measure the Hz of the topic", "how irregularly samples come")
    tmux("send-keys", "?")
    eventually(lambda: "irregularly" not in tmux("capture-pane", "-p"))
    tmux("send-keys", "m")
    eventually(lambda: re.search(r"chat .* \d+\.\d ", tmux("capture-pane", "-p")))
    tmux("send-keys", "1")
    shows("frame ▼")
    tmux("send-keys", "/")
    shows("words that a row must contain")
    tmux("send-keys", "came")
    eventually(lambda: "odometry" not in tmux("capture-pane", "-p"))
    tmux("send-keys", "Enter")

    def opened() -> bool:
        tmux("send-keys", "Enter")
        return "Publisher: /mount on" in tmux("capture-pane", "-p")

    eventually(opened)
    shows("Kind: static", "Position: 0.000, 0.000, 0.000 m")
    assert "Rate" not in tmux("capture-pane", "-p")
    tmux("send-keys", "Escape")
    eventually(lambda: "Publisher" not in tmux("capture-pane", "-p"))
    tmux("send-keys", "q")
    shows("left")


def test_without_a_terminal_it_says_what_to_use(bus: Bus) -> None:
    """Piped, it names the tools that are for scripts, with exit code 2."""
    done = bus.run("top")
    assert done.returncode == 2
    assert "needs a terminal" in done.stderr and "tfbus frames" in done.stderr


def test_two_rows_of_one_key_are_one() -> None:
    """A node that answers twice, from whatever fault, is one row, as it said last."""
    rows = tuple(Row("/sim 1", (Cell(text, text),)) for text in ("first", "second"))
    table = ScreenTable("nodes", ("node",), rows)
    assert [row.cells[0].text for row in table.rows] == ["second"]


def test_a_node_that_loses_ticks_names_the_callback() -> None:
    """How many ticks and messages it lost, to sort by, and who held up the most of them."""
    delays = (
        DelayDescription("timer a", 70, "topic scan", 0.2),
        DelayDescription("b", 2, "c", 1.0),
    )
    node = NodeDescription("/n", "h", 7, "0.1.0", "s", 0, (), (), {}, {}, {}, {}, delays=delays)
    table = nodes_table([node, replace(node, name="/m", delays=())])
    assert table.headings[-1] == "lost"
    assert [row.cells[-1].text for row in table.rows] == ["72 by topic scan", ""]
    assert [row.cells[-1].value for row in table.rows] == [72, float("inf")]


def test_numbers_of_a_frame_are_those_of_the_monitor() -> None:
    """Each number that the monitor has of an edge on a bus is a column; a root has none."""
    buffer = Buffer()
    buffer.set_transform(TransformStamped(10**18, "base", "hand", Transform()), authority="arm")
    flow = EdgeFlow("arm", "base", "hand", rate_hz=9.5, out_of_order=3)
    moment = BusMoment(at_ns=10**18, tree=frame_tree(buffer, (), 2 * 10**9 + 10**18))
    report = Report(moment, {("arm", "hand"): flow}, SpanMeter(0, 1), None)
    table = frames_table(report)
    numbers = [each for each in EDGES if each.has_needs(report)]
    assert [each.heading for each in numbers] == list(table.headings[3:-1])
    rows = {row.key: dict(zip(table.headings, row.cells, strict=True)) for row in table.rows}
    hand = {name: cell.text for name, cell in rows["hand"].items() if cell.text}
    names = {"frame": "hand", "parent": "base", "stream": "arm"}
    assert hand == {**names, "Hz": "9.5", "age": "2.0 s", "disordered": "3"}
    assert {name for name, cell in rows["base"].items() if cell.text} == {"frame", "state"}
    assert set(table.least_useful) == {*table.headings} - {"frame", "Hz", "state"}


# A signal in the midst of Textual's code, wherever that is.
_INTERRUPTED = """
import signal, sys
from tfbus.top.app import TopApp
look, looks = TopApp._update_tables, []
def interrupted(self):
    looks.append(1)
    if len(looks) == 2:
        signal.raise_signal(signal.SIGINT)
    look(self)
TopApp._update_tables = interrupted
from tfbus.__main__ import main
main()
"""


@pytest.mark.real
def test_a_signal_ends_it_as_its_key_does(tmux: Tmux, tmp_path: Path) -> None:
    """Ctrl-C that is sent as a signal leaves no process, and the terminal as it was."""
    program = tmp_path / "interrupted.py"
    program.write_text(_INTERRUPTED)
    begun = f"{sys.executable} {program} top; echo left $? $(stty -a | grep -o .icanon); cat"
    tmux("new-session", "-d", "-x", "80", "-y", "24", begun)
    eventually(lambda: "left 0 icanon" in tmux("capture-pane", "-p").replace("  ", " "))
