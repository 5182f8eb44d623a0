"""The tree of frames as a whole: its texts, pictures and problems."""

import json
from dataclasses import replace

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from tfbus import Buffer, Transform, TransformStamped
from tfbus.base.wording import duration
from tfbus.frames import document
from tfbus.frames.clocks import SimulatedTime
from tfbus.frames.document import edge_lines, tree_lines
from tfbus.frames.picture import Size, outline, tidy
from tfbus.frames.snapshot import FrameTree, Problem, frame_tree
from tfbus.streams.info import StreamInfo

NS = 1_000_000_000
NOW_NS = 1_670_400_300 * NS


def buffer_of(*edges: tuple[str, str], static: tuple[str, ...] = (), by: str = "sim") -> Buffer:
    """A buffer with 2 s of 10 Hz of each edge, or one static transform."""
    buffer = Buffer()
    for parent, child in edges:
        for back in range(1 if child in static else 21):
            stamp_ns = NOW_NS - back * NS // 10
            edge = TransformStamped(stamp_ns, parent, child, Transform.identity())
            buffer.set_transform(edge, static=child in static, authority=by)
    return buffer


def stream(name: str, *edges: tuple[str, str], alive: bool = True) -> StreamInfo:
    rows = tuple((parent, child, False) for parent, child in edges)
    return StreamInfo(name, node=f"/{name}", host="robot7", pid=42, alive=alive, frames=rows)


def tree_of(buffer: Buffer, *streams: StreamInfo, now_ns: int = NOW_NS) -> FrameTree:
    return frame_tree(buffer, streams, now_ns)


def test_the_tree_is_drawn_as_lines() -> None:
    """One line per frame, below its parent, with the most important facts of its edge."""
    buffer = buffer_of(
        ("world", "turtle1"), ("turtle1", "drone"), ("world", "camera"), static=("camera",)
    )
    assert tree_lines(tree_of(buffer), width=60) == [
        "world",
        "├─ camera    static, by sim",
        "└─ turtle1   0.0 ms old, 10.0 Hz over 2.0 s, by sim",
        "   └─ drone  0.0 ms old, 10.0 Hz over 2.0 s, by sim",
    ]


def test_lines_fit_the_width() -> None:
    """A line that would be too long omits the least important facts."""
    lines = tree_lines(tree_of(buffer_of(("world", "turtle1"))), width=46)
    assert lines[1] == "└─ turtle1  0.0 ms old, 10.0 Hz over 2.0 s"


def test_stale_and_gone_frames_say_so() -> None:
    """A frame silent for three of its periods and a second is stale; one whose publisher has gone
    is gone.
    """
    buffer = buffer_of(("world", "turtle1"), ("world", "turtle2"))
    buffer.mark_gone(["turtle2"], True, "sim")
    lines = tree_lines(tree_of(buffer, now_ns=NOW_NS + 2 * NS))
    assert lines[1:] == [
        "├─ turtle1  STALE, 2.0 s old, 10.0 Hz over 2.0 s, by sim",
        "└─ turtle2  GONE, 2.0 s old, 10.0 Hz over 2.0 s, by sim",
    ]
    assert "STALE" not in "".join(tree_lines(tree_of(buffer, now_ns=NOW_NS + NS)))


def test_the_long_form_has_all_facts() -> None:
    """Publisher, rate, samples, stamps and delay of each edge."""
    assert edge_lines(tree_of(buffer_of(("world", "turtle1")), stream("sim"))) == [
        "world -> turtle1",
        "  Publisher: /sim on robot7, pid 42, stream 'sim'",
        "  Kind: dynamic",
        "  Rate: 10.000 Hz, 21 samples over 2.0 s",
        "  Newest: 1670400300.000000000, 0.0 ms old",
        "  Oldest: 1670400298.000000000",
        "  Delay of its stream, smoothed: ?",
    ]


def test_problems_fit_the_width_too() -> None:
    """Sentences about publishers and problems are wrapped and indented."""
    tree = tree_of(buffer_of(("world", "turtle1"), ("isle", "palm")))
    lines = document.summary(tree, width=50)
    report = lines[lines.index("Problems:") + 1 :]
    assert report[0].startswith("  disconnected: ")
    assert all(line.startswith("    ") for line in report[1:])
    assert len(report) > 1
    assert max(map(len, lines)) <= 50


class TestProblems:
    def problems(self, buffer: Buffer, *streams: StreamInfo) -> list[Problem]:
        return list(tree_of(buffer, *streams).problems())

    def test_one_tree_of_living_publishers_has_none(self) -> None:
        """If each frame has one living publisher and is below one root, nothing is wrong."""
        edges = (("world", "a"), ("a", "b"))
        assert self.problems(buffer_of(*edges), stream("sim", *edges)) == []

    def test_separate_trees(self) -> None:
        """A second root is named, with the larger tree that it is separate from."""
        buffer = buffer_of(("map", "a"), ("map", "b"), ("odom", "c"))
        (problem,) = self.problems(buffer)
        assert (problem.kind, problem.frames) == ("disconnected", ("odom", "c"))
        assert "1 frame below it" in problem.text and "tree of 'map'" in problem.text

    def test_a_misspelt_parent(self) -> None:
        """The root of a separate tree that is a slip of a frame is named with that."""
        buffer = buffer_of(("odom", "base_link"), ("odom", "cup"), ("base_lnk", "gripper"))
        (problem,) = self.problems(buffer)
        assert problem.text.endswith("; did you mean 'base_link' by 'base_lnk'?")
        (problem,) = self.problems(buffer_of(("map", "turtle1"), ("map", "a"), ("turtle2", "b")))
        assert problem.text.endswith(" to the tree of 'map'")

    def test_a_frame_alone(self) -> None:
        """A frame without any edge is an orphan if a living stream lists it."""
        buffer = buffer_of(("map", "a"), ("lost", "b"))
        buffer.remove("b")
        orphan, silent = self.problems(buffer, stream("sim", ("lost", "b")))
        assert (orphan.kind, orphan.frames) == ("orphan", ("lost",))
        assert orphan.text.startswith("'lost' is alone")
        assert silent.frames == ("b",)

    def test_a_parent_without_children_is_not_shown(self) -> None:
        """It was known by the edge to its last child, which is not there any more."""
        buffer = buffer_of(("map", "a"), ("lost", "b"))
        buffer.remove("b")
        assert tree_of(buffer).frames.keys() == {"map", "a"}
        assert self.problems(buffer) == []

    def test_two_publishers(self) -> None:
        """Two living publishers of one frame are named with their nodes, hosts and parents."""
        edge = ("world", "turtle1")
        publishers = stream("a", edge), stream("b", ("map", "turtle1"))
        (problem,) = self.problems(buffer_of(edge), *publishers)
        assert (problem.kind, problem.frames) == ("conflict", ("turtle1",))
        assert "/a on robot7, pid 42 under " in problem.text
        assert "/b on robot7, pid 42 under " in problem.text
        gone = stream("b", edge, alive=False)
        assert self.problems(buffer_of(edge), stream("a", edge), gone) == []

    def test_a_loop(self) -> None:
        """A loop that publishers would make together is a problem; a buffer never closes it."""
        report = self.problems(
            buffer_of(("a", "b"), ("b", "c")),
            stream("one", ("a", "b"), ("b", "c")),
            stream("two", ("c", "a")),
        )
        assert report[0].kind == "loop"
        assert report[0].text.startswith("'b' -> 'c' -> 'a' -> 'b' ")
        assert "/one on robot7, pid 42" in report[0].text
        assert "/two on robot7, pid 42" in report[0].text

    def test_frames_that_never_came(self) -> None:
        """A frame that a publisher lists but has not sent is silent."""
        edges = (("world", "a"), ("a", "b"))
        (problem,) = self.problems(buffer_of(edges[0]), stream("sim", *edges))
        assert (problem.kind, problem.frames) == ("silent", ("b",))
        assert "/sim on robot7, pid 42" in problem.text

    def test_stamps_in_another_unit(self) -> None:
        """Stamps in seconds are one problem of their publisher, and give no rate."""
        buffer = buffer_of(("world", "a"))
        for child in ("b", "c"):
            for second in range(3):
                stamp_ns = NOW_NS // NS - second
                ts = TransformStamped(stamp_ns, "a", child, Transform.identity())
                buffer.set_transform(ts, authority="odom")
        publishers = stream("sim", ("world", "a")), stream("odom", ("a", "b"), ("a", "c"))
        (problem,) = self.problems(buffer, *publishers)
        assert (problem.kind, problem.frames) == ("unit", ("b", "c"))
        assert "/odom on robot7, pid 42" in problem.text and "like seconds" in problem.text
        rates = {name: it.rate_hz for name, it in tree_of(buffer, *publishers).frames.items()}
        assert rates == {"world": None, "a": pytest.approx(10.0), "b": None, "c": None}

    def test_stamps_of_zero(self) -> None:
        """They are one problem of their publisher, but not near the beginning of a simulation."""
        buffer = Buffer()
        buffer.set_transform(TransformStamped(0, "a", "b", Transform.identity()), authority="sim")
        (problem,) = self.problems(buffer, stream("sim", ("a", "b")))
        assert (problem.kind, problem.frames) == ("unit", ("b",))
        assert "/sim on robot7" in problem.text and " are 0, " in problem.text
        assert tree_of(buffer, stream("sim", ("a", "b")), now_ns=5 * NS).problems() == []

    def test_stamps_ahead(self) -> None:
        """They are one problem of their publisher: its stamps, or the clock of its host."""
        buffer = buffer_of(("world", "a"))
        for child in ("b", "c"):
            ts = TransformStamped(NOW_NS + 300 * NS, "a", child, Transform.identity())
            buffer.set_transform(ts, authority="odom")
        publishers = stream("sim", ("world", "a")), stream("odom", ("a", "b"), ("a", "c"))
        (problem,) = self.problems(buffer, *publishers)
        assert (problem.kind, problem.frames) == ("ahead", ("b", "c"))
        assert "5 min in the future" in problem.text
        assert "/odom on robot7, pid 42" in problem.text and "node.now_ns()" in problem.text
        skewed = replace(publishers[1], clock_offset_s=300.0)
        (problem,) = self.problems(buffer, publishers[0], skewed)
        assert (problem.kind, problem.frames) == ("ahead", ("b", "c"))
        assert "clocks of robot7" in problem.text and "NTP" in problem.text

    def test_stamps_long_past(self) -> None:
        """Samples that come late are one problem of their publisher: its stamps, or its clock."""
        edges = ("world", "a"), ("a", "b")
        late = replace(stream("sim", *edges), delay_s=5.1, last_delay_s=5.0)
        (problem,) = self.problems(buffer_of(*edges), late)
        assert (problem.kind, problem.frames) == ("late", ("a", "b"))
        assert "come 5.0 s after their stamps" in problem.text
        assert "/sim on robot7, pid 42" in problem.text and "node.now_ns()" in problem.text
        (problem,) = self.problems(buffer_of(*edges), replace(late, clock_offset_s=-5.0))
        assert "clocks of robot7" in problem.text and "NTP" in problem.text

    @pytest.mark.parametrize(
        "changes",
        [
            {"last_delay_s": 0.01},  # what had waited for this process has come
            {"last_delay_s": 0.4},  # five periods are more
            {"last_delay_s": None},
        ],
    )
    def test_what_comes_soon_enough_is_not_late(self, changes: dict[str, float | None]) -> None:
        """A mean that is late says nothing while the last sample is not."""
        edge = ("world", "a")
        soon = replace(stream("sim", edge), **({"delay_s": 3.0} | changes))
        assert self.problems(buffer_of(edge), soon) == []

    def test_old_stamps_are_right_where_a_clock_is_published(self) -> None:
        """A player with the recorded stamps publishes the recorded time, and does not follow it."""
        edge = ("world", "a")
        played = replace(stream("play", edge), delay_s=3600.0, last_delay_s=3600.0)
        time = SimulatedTime(("/play",), frozenset(), 1)
        assert frame_tree(buffer_of(edge), [played], NOW_NS, time).problems() == []

    def test_gone_publishers(self) -> None:
        """The frames of a gone publisher are one problem, which names the first five."""
        edges = [("world", f"leg{i}") for i in range(8)]
        buffer = buffer_of(*edges)
        buffer.mark_gone([child for _, child in edges], True, "sim")
        (problem,) = self.problems(buffer, stream("sim", *edges, alive=False))
        assert (problem.kind, problem.frames) == ("gone", tuple(child for _, child in edges))
        assert "'leg4' and 3 more" in problem.text and "/sim on robot7, pid 42" in problem.text


class TestDocuments:
    tree = tree_of(
        buffer_of(("world", 'a "b"'), ("world", "camera"), static=("camera",)), stream("sim")
    )

    def test_json(self) -> None:
        """JSON has every frame with its parent, rate, age and publisher."""
        report = json.loads(document.as_json(self.tree))
        frames = {frame["name"]: frame for frame in report["frames"]}
        assert report["roots"] == ["world"]
        assert frames["camera"]["static"]
        assert frames['a "b"']["rate_hz"] == pytest.approx(10.0)
        assert (frames['a "b"']["parent"], frames['a "b"']["node"]) == ("world", "/sim")

    def test_yaml(self) -> None:
        """YAML has the form of tf2's, which its readers know."""
        report = yaml.safe_load(document.as_tf2_yaml(self.tree))
        assert report["camera"]["parent"] == "world"
        assert report["camera"]["rate"] == 10000.0

    def test_mermaid(self) -> None:
        """Mermaid's flowchart names each frame once, with special characters escaped."""
        lines = document.as_mermaid(self.tree).splitlines()
        assert lines[:4] == [
            "flowchart TD",
            '  f0["a &quot;b&quot;"]',
            '  f1["camera"]',
            '  f2["world"]',
        ]
        assert lines[5] == '  f2 -->|"static<br/>by sim"| f1'

    def test_text(self) -> None:
        """The text is the output in the terminal."""
        assert document.as_text(self.tree).splitlines()[-2:] == [
            "Publishers:",
            "  sim: /sim on robot7, pid 42, 0 frames",
        ]


@given(st.lists(st.integers(min_value=0, max_value=10**6), min_size=1, max_size=40))
def test_no_two_frames_are_drawn_over_each_other(choices: list[int]) -> None:
    """In both layouts each frame has its own place, to the right of its parent."""
    names = ["root"]
    edges = []
    for number, choice in enumerate(choices):
        edges.append((names[choice % len(names)], f"f{number}"))
        names.append(f"f{number}")
    tree = tree_of(buffer_of(*edges, static=tuple(names)))
    sizes = {name: Size(1.0, 1.5) for name in names}
    for layout in (tidy, outline):
        places = layout(tree, sizes)
        assert places.keys() == set(names)
        assert len({(place.x, round(place.y, 6)) for place in places.values()}) == len(names)
        assert all(places[child].x > places[parent].x for parent, child in edges)


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (0.00034, "0.3 ms"),
        (0.021, "21 ms"),
        (4.2, "4.2 s"),
        (200.0, "3 min"),
        (7300.0, "2 h"),
        (500_000.0, "6 days"),
        (-2.0, "-2.0 s"),
        (None, "?"),
    ],
)
def test_durations_are_written_for_people(seconds: float | None, text: str) -> None:
    """A duration has the unit that makes it short."""
    assert duration(seconds) == text
