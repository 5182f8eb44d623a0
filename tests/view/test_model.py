"""What `tfbus view` shows, known without a page: states of frames, poses, trails, filters, time."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tfbus import Buffer, FrameInfo, SettingsError, Transform, TransformStamped
from tfbus.view.model.filter import NameFilter, PatternError
from tfbus.view.model.frames import Frames, FrameWatch
from tfbus.view.model.placement import arrow_points, arrow_rows, newest_common_ns, place, trail
from tfbus.view.model.playback import Playback
from tfbus.view.model.settings import ViewSettings, load, save
from tfbus.view.model.status import FADED, Status, judge, opacity_of, stale_after_s
from tfbus.view.panels import text

S = 1_000_000_000


class Clock:
    """A clock that stands still until it is set."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


def send(
    buffer: Buffer,
    parent: str,
    child: str,
    *,
    at_ns: int = S,
    x: float = 1.0,
    static: bool = False,
    by: str = "arm",
) -> None:
    """Let a child be x metres ahead of its parent."""
    pose = Transform((x, 0.0, 0.0))
    buffer.set_transform(TransformStamped(at_ns, parent, child, pose), static=static, authority=by)


@pytest.fixture
def buffer() -> Buffer:
    """map -> base -> tool, moving at 10 Hz for a second, base a metre and tool two from map."""
    buffer = Buffer()
    for tick in range(11):
        send(buffer, "map", "base", at_ns=S + tick * S // 10)
        send(buffer, "base", "tool", at_ns=S + tick * S // 10)
    return buffer


def look(buffer: Buffer, fixed_frame: str = "map") -> Frames:
    """The frames as they are at first sight."""
    return FrameWatch(buffer, Clock()).look({}, fixed_frame)


# States


def test_a_frame_without_news_for_three_of_its_periods_is_stale() -> None:
    """A frame of 0.5 Hz may be silent for six seconds; one of 100 Hz for a second, as the least."""
    assert stale_after_s(0.5) == 6.0
    assert stale_after_s(100.0) == 1.0
    slow = FrameInfo("slow", parent="map", rate_hz=0.5)
    assert judge(slow, 5.9, 1) is Status.FRESH
    assert judge(slow, 6.1, 1) is Status.STALE


@pytest.mark.parametrize(
    ("info", "publishers", "status"),
    [
        (FrameInfo("map"), 0, Status.ROOT),
        (FrameInfo("base", parent="map", rate_hz=10.0), 1, Status.FRESH),
        (FrameInfo("base", parent="map", static=True), 1, Status.STATIC),
        (FrameInfo("base", parent="map", static=True, gone=True), 0, Status.GONE),
        (FrameInfo("base", parent="map", rate_hz=10.0), 2, Status.CONFLICT),
    ],
)
def test_each_state_has_its_status(info: FrameInfo, publishers: int, status: Status) -> None:
    """Root, fresh, static, gone and in conflict are told apart."""
    assert judge(info, 0.0, publishers) is status


@given(st.floats(0.0, 1e6), st.floats(0.0, 1e6), st.floats(0.01, 1e3))
def test_what_is_stale_only_fades(one_s: float, other_s: float, rate_hz: float) -> None:
    """The longer a frame is silent the less is left of it, and never less than a quarter."""
    early, late = sorted((one_s, other_s))
    limit_s = stale_after_s(rate_hz)
    before = opacity_of(Status.STALE, limit_s + early, rate_hz)
    after = opacity_of(Status.STALE, limit_s + late, rate_hz)
    assert FADED <= after <= before <= 1.0


def test_silence_is_measured_by_our_own_clock(buffer: Buffer) -> None:
    """A frame is stale when nothing new comes, whatever the publisher's clock says."""
    clock = Clock()
    watch = FrameWatch(buffer, clock)
    assert watch.look({}, "map").states["tool"].status is Status.FRESH
    clock.now_s += 5.0
    send(buffer, "map", "base", at_ns=3 * S)
    frames = watch.look({}, "map")
    assert frames.states["base"].status is Status.FRESH
    assert frames.states["tool"].status is Status.STALE
    assert frames.states["tool"].silent_s == 5.0


def test_a_frame_that_two_streams_describe_is_in_conflict(buffer: Buffer) -> None:
    """Both publishers of it are named."""
    rows = [("map", "base", False)]
    frames = FrameWatch(buffer).look({"left": rows, "right": rows}, "map")
    assert frames.states["base"].status is Status.CONFLICT
    assert frames.states["base"].publishers == ("left", "right")
    assert "sent by left and right" in text.explained(frames.states["base"])


# Trees


def test_trees_are_listed_from_their_roots_the_largest_first(buffer: Buffer) -> None:
    """Parents come before their children, and children by name."""
    send(buffer, "map", "arm")
    send(buffer, "island", "palm")
    frames = look(buffer)
    assert [(state.name, state.depth) for state in frames] == [
        ("map", 0),
        ("arm", 1),
        ("base", 1),
        ("tool", 2),
        ("island", 0),
        ("palm", 1),
    ]
    assert frames.roots == ["map", "island"]
    assert frames.tree_of("palm") == ["island", "palm"]


def test_a_tree_apart_says_why_in_the_buffers_words(buffer: Buffer) -> None:
    """Frames that no path joins to the fixed frame have the buffer's reason."""
    send(buffer, "island", "palm")
    states = look(buffer).states
    assert states["tool"].unplaced == ""
    assert "'island'" in states["palm"].unplaced
    assert states["palm"].unplaced == states["island"].unplaced


@pytest.mark.parametrize(
    ("edges", "fixed_frame"),
    [
        ([], ""),
        ([("map", "base"), ("map", "arm"), ("a", "b")], "map"),
        ([("map", "base"), ("map", "arm"), ("world", "b")], "world"),
    ],
)
def test_the_fixed_frame_is_world_or_the_root_of_the_largest_tree(
    edges: list[tuple[str, str]], fixed_frame: str
) -> None:
    """Where nobody has chosen one."""
    buffer = Buffer()
    for parent, child in edges:
        send(buffer, parent, child)
    assert look(buffer).natural_fixed_frame() == fixed_frame


# Places


def test_frames_are_placed_in_the_fixed_frame(buffer: Buffer) -> None:
    """Positions in metres, quaternions with w first, as viewers want them."""
    placed = place(buffer, "map", ["map", "base", "tool", "nowhere"], None)
    assert placed.names == ("map", "base", "tool")
    assert placed.xyz.tolist() == [[0, 0, 0], [1, 0, 0], [2, 0, 0]]
    assert placed.quat_wxyz.tolist() == [[1, 0, 0, 0]] * 3
    assert "'nowhere'" in placed.missing["nowhere"]
    assert placed.extent_m() == 2.0


def test_the_past_is_placed_as_it_was(buffer: Buffer) -> None:
    """At a time before all data nothing moving has a place, and the reason is the buffer's."""
    send(buffer, "base", "tool", at_ns=3 * S, x=5.0)
    send(buffer, "map", "base", at_ns=3 * S)
    assert place(buffer, "map", ["tool"], 2 * S).xyz[0, 0] == 2.0
    assert place(buffer, "map", ["tool"], 3 * S).xyz[0, 0] == 6.0
    missing = place(buffer, "map", ["tool"], S // 2).missing["tool"]
    assert "oldest sample is 500.000 ms later" in missing


def test_arrows_go_from_child_to_parent(buffer: Buffer) -> None:
    """But for frames that lie on their parent to a millimetre, as in RViz."""
    send(buffer, "tool", "tip", x=0.0009)
    placed = place(buffer, "map", ["map", "base", "tool", "tip"], S)
    parents = {"map": None, "base": "map", "tool": "base", "tip": "tool"}
    rows = arrow_rows(placed.names, parents)
    points, kept = arrow_points(placed.xyz, *rows)
    assert [placed.names[row] for row in rows[0][kept]] == ["base", "tool"]
    assert points[kept].tolist() == [[[1, 0, 0], [0, 0, 0]], [[2, 0, 0], [1, 0, 0]]]


@given(st.tuples(*[st.floats(-3.1, 3.1)] * 3), st.tuples(*[st.floats(-1e3, 1e3)] * 3))
def test_places_are_those_that_the_buffer_tells(
    rpy: tuple[float, float, float], xyz: tuple[float, float, float]
) -> None:
    """Whatever the pose."""
    buffer = Buffer()
    pose = Transform.from_rpy(*rpy, xyz=xyz)
    buffer.set_transform(TransformStamped(S, "map", "base", pose))
    placed = place(buffer, "map", ["base"], None)
    w, x, y, z = placed.quat_wxyz[0]
    assert Transform(placed.xyz[0], (x, y, z, w)).is_close(pose, 1e-7)


def test_a_trail_is_where_the_frame_was_as_far_as_it_is_known(buffer: Buffer) -> None:
    """Of the last five seconds before 2 s only one is known here: 31 points at 30 Hz."""
    path = trail(buffer, "map", "tool", 2 * S, 5.0)
    assert path.shape == (31, 3)
    assert np.all(path[:, 0] == 2.0)
    assert trail(buffer, "map", "nowhere", 2 * S, 5.0).shape == (0, 3)


def test_a_pause_holds_the_latest_time_at_which_all_can_be_placed(buffer: Buffer) -> None:
    """Which is that of the slowest frame."""
    send(buffer, "map", "base", at_ns=9 * S)
    assert newest_common_ns(buffer, "map", ["map", "base", "tool", "nowhere"]) == 2 * S


# Choices


def test_following_shows_the_latest_and_scrubbing_a_time_before_the_pause() -> None:
    """The time held does not move while the slider does."""
    following = Playback()
    assert following.stamp_ns is None
    paused = following.pause(10 * S)
    assert paused.stamp_ns == 10 * S
    assert paused.pause(20 * S) == paused
    assert paused.scrub(20 * S, 1.5).stamp_ns == 8_500_000_000
    assert following.scrub(20 * S, 1.0).stamp_ns == 19 * S


def test_filters_take_names_by_regular_expressions() -> None:
    """`only` has to be found in the name and `never` not, anywhere."""
    names = ["robot1/base", "robot1/camera_optical", "robot2/base"]
    only = NameFilter(only="^robot1", never="optical$")
    assert [name for name in names if only.takes(name)] == ["robot1/base"]
    assert all(map(NameFilter().takes, names))


def test_a_bad_regular_expression_says_what_is_wrong_and_where() -> None:
    """In one sentence, with what to write instead."""
    with pytest.raises(PatternError, match=r"'arm\(' is no regular expression: .* character 4"):
        NameFilter(only="arm(")


def test_settings_are_read_as_they_were_saved(tmp_path: Path) -> None:
    """All of them."""
    settings = ViewSettings(
        fixed_frame="map", dark=True, scale=2.5, only="^robot", hidden=("a", "b/c"), trails=("d",)
    )
    save(settings, tmp_path / "view.yaml")
    assert load(tmp_path / "view.yaml") == settings


@pytest.mark.parametrize(
    ("written", "said"),
    [
        ("scale: big", "scale is 'big'; a number is wanted"),
        ("scale: 1000", "scale is 1000; a number from 0.1 to 10 is wanted"),
        ("colour: red", "there is no setting 'colour'; there are: fixed_frame, selected"),
        ("axes: 1", "axes is 1; true or false is wanted"),
        ("hidden: base", "hidden is 'base'; a list of names of frames is wanted"),
        ("only: '('", "'(' is no regular expression"),
        ("- a", "is not a map of settings"),
        ("a: [", "is not YAML"),
    ],
)
def test_wrong_settings_are_refused_in_one_sentence(
    tmp_path: Path, written: str, said: str
) -> None:
    """With what was wrong and what would do."""
    path = tmp_path / "view.yaml"
    path.write_text(written)
    with pytest.raises(SettingsError) as caught:
        load(path)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


# Texts


def test_what_lies_between_two_frames_is_said_as_echo_does(buffer: Buffer) -> None:
    """Distance and angle in one line, then tf2_echo's block."""
    turned = Transform.from_rpy(0.0, 0.0, -np.pi / 2, (0.0, 3.0, 4.0))
    buffer.set_transform(TransformStamped(2 * S, "base", "hook", turned))
    summary, block = text.between(buffer, "base", "hook", None)
    assert summary == "5.000 m apart, turned by 90.0°"
    assert block.startswith("At time 2.000000000\n- Translation: [0.000, 3.000, 4.000]")


def test_the_headline_says_what_is_waited_for() -> None:
    """Before any transform, and where the fixed frame is not there."""
    assert "Waiting for transforms" in text.headline(Frames(), "", Playback())
    buffer = Buffer()
    send(buffer, "map", "base")
    assert "no frame 'mop'" in text.headline(look(buffer, "mop"), "mop", Playback()).replace(
        "&#x27;", "'"
    )
    assert "2 frames, seen from <b>map</b>" in text.headline(look(buffer), "map", Playback())


def test_no_name_of_a_frame_becomes_markup() -> None:
    """Frames may have any name, also that of a script."""
    buffer = Buffer()
    send(buffer, "<script>", "<b>&")
    frames = look(buffer, "<script>")
    assert "<script>" not in text.headline(frames, "<script>", Playback())
    assert "<b>&" not in text.facts(frames.states["<b>&"], S)
