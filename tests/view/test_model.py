"""The state of `tfbus view`, tested without a page: states, poses, trails, filters, time."""

import re
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tfbus import Buffer, SettingsError, Transform, TransformStamped
from tfbus.frames.moment import BusMoment
from tfbus.frames.snapshot import frame_tree
from tfbus.streams.info import StreamInfo
from tfbus.view.frames import (
    FADED,
    Frames,
    arrow_points,
    arrow_rows,
    fading,
    frames_of,
    newest_common_ns,
    place,
    trail,
)
from tfbus.view.panels.markup import clock_time
from tfbus.view.panels.panel import headline_of, nothing_recorded
from tfbus.view.panels.tree import between, explained, facts_of
from tfbus.view.settings import (
    NameFilter,
    PatternError,
    Playback,
    ViewSettings,
    holds_settings,
    load_settings,
    read_settings,
    save_settings,
)

S = 1_000_000_000


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
    """Put a child x metres ahead of its parent."""
    pose = Transform((x, 0.0, 0.0))
    buffer.set_transform(TransformStamped(at_ns, parent, child, pose), static=static, authority=by)


@pytest.fixture
def buffer() -> Buffer:
    """map -> base -> tool at 10 Hz from 1 s to 2 s, base a metre and tool two from map."""
    buffer = Buffer()
    for tick in range(11):
        send(buffer, "map", "base", at_ns=S + tick * S // 10)
        send(buffer, "base", "tool", at_ns=S + tick * S // 10)
    return buffer


def look(
    buffer: Buffer, fixed_frame: str = "map", *streams: StreamInfo, at_ns: int = 2 * S
) -> Frames:
    """The frames at a time."""
    return frames_of(
        BusMoment(at_ns=at_ns, tree=frame_tree(buffer, streams, at_ns)), buffer, fixed_frame
    )


# States; how they are judged is tested in tests/frames/test_states_agree.py.


@given(st.floats(0.0, 1e6), st.floats(0.0, 1e6), st.floats(1.0, 1e3))
def test_a_stale_frame_only_fades(one_s: float, other_s: float, limit_s: float) -> None:
    """The longer a frame is silent the lower its opacity, but never below a quarter."""
    early, late = sorted((one_s, other_s))
    before = fading(limit_s + early, limit_s)
    after = fading(limit_s + late, limit_s)
    assert FADED <= after <= before <= 1.0


def test_a_stale_frame_says_for_how_long_it_has_been_silent(buffer: Buffer) -> None:
    """It fades, and its facts name the time."""
    send(buffer, "map", "base", at_ns=7 * S)
    frames = look(buffer, at_ns=7 * S)
    assert (frames["base"].state, frames["base"].opacity) == ("dynamic", 1.0)
    assert (frames["tool"].state, frames["tool"].silent_s) == ("stale", 5.0)
    assert frames["tool"].opacity < 1.0
    assert explained(frames["tool"]) == "stale: no sample for 5.0 s"


def test_a_frame_that_is_ahead_says_by_how_much(buffer: Buffer) -> None:
    """It is a fault, but it does not fade: its samples come."""
    send(buffer, "map", "base", at_ns=302 * S)
    frames = look(buffer, at_ns=2 * S)
    assert (frames["base"].state, frames["base"].opacity) == ("ahead", 1.0)
    said = explained(frames["base"])
    assert said.startswith("ahead: ") and said.endswith(" 5 min in the future")
    assert "1 ahead" in headline_of(frames, "map", Playback())


def test_a_conflict_names_both_publishers(buffer: Buffer) -> None:
    """Also beside a frame that is gone."""
    rows = (("map", "base", False),)
    sides = [StreamInfo(name, alive=True, frames=rows) for name in ("right", "left")]
    base = look(buffer, "map", *sides)["base"]
    assert (base.state, base.publishers) == ("conflict", ("left", "right"))
    conflict = explained(base)
    assert conflict.startswith("conflict: ") and conflict.endswith("left and right")
    buffer.mark_gone(["base"], True, "arm")
    both = explained(look(buffer, "map", *sides)["base"])
    assert both.startswith("gone: ") and both.endswith(f"; {conflict}")


# Trees


def test_trees_are_listed_from_their_roots_the_largest_first(buffer: Buffer) -> None:
    """Parents come before their children, and children by name."""
    send(buffer, "map", "arm")
    send(buffer, "island", "palm")
    frames = look(buffer)
    assert [(frame.name, frame.depth) for frame in frames] == [
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
    """Frames that are not connected to the fixed frame have the buffer's reason."""
    send(buffer, "island", "palm")
    frames = look(buffer)
    assert frames["tool"].unplaced == ""
    assert "'island'" in frames["palm"].unplaced
    assert frames["palm"].unplaced == frames["island"].unplaced


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
    """Unless another is chosen."""
    buffer = Buffer()
    for parent, child in edges:
        send(buffer, parent, child)
    assert look(buffer).natural_fixed_frame() == fixed_frame


def test_a_world_that_lost_its_only_child_is_no_fixed_frame() -> None:
    """A second publisher took a frame into world for a while; the robot's tree is seen again."""
    buffer = Buffer()
    send(buffer, "map", "base")
    send(buffer, "world", "camera")
    send(buffer, "base", "camera", at_ns=2 * S)
    assert look(buffer).natural_fixed_frame() == "map"


# Places


def test_frames_are_placed_in_the_fixed_frame(buffer: Buffer) -> None:
    """Positions in metres, quaternions with w first, as viser has them."""
    placed = place(buffer, "map", ["map", "base", "tool", "nowhere"], None)
    assert placed.names == ("map", "base", "tool")
    assert placed.xyz.tolist() == [[0, 0, 0], [1, 0, 0], [2, 0, 0]]
    assert placed.quat_wxyz.tolist() == [[1, 0, 0, 0]] * 3
    assert "'nowhere'" in placed.missing["nowhere"]
    assert placed.extent_m() == 2.0


def test_a_frame_that_is_too_far_to_draw_is_missing(buffer: Buffer) -> None:
    """Two transforms of a stranger may add up to infinity: all other frames are drawn."""
    for parent, child in (("map", "far"), ("far", "farther")):
        send(buffer, parent, child, x=1.7e308, by="stranger")
    placed = place(buffer, "map", ["map", "far", "farther", "base"], None)
    assert placed.names == ("map", "base")
    assert placed.missing.keys() == {"far", "farther"}
    assert len(trail(buffer, "map", "farther", S, 1.0)) == 0
    assert place(buffer, "farther", ["map", "farther"], None).names == ("farther",)


def test_the_past_is_placed_as_it_was(buffer: Buffer) -> None:
    """At a time before all data no dynamic frame has a place, and the reason is the buffer's."""
    send(buffer, "base", "tool", at_ns=3 * S, x=5.0)
    send(buffer, "map", "base", at_ns=3 * S)
    assert place(buffer, "map", ["tool"], 2 * S).xyz[0, 0] == 2.0
    assert place(buffer, "map", ["tool"], 3 * S).xyz[0, 0] == 6.0
    missing = place(buffer, "map", ["tool"], S // 2).missing["tool"]
    assert "sample is 500.000 ms later" in missing


def test_arrows_go_from_child_to_parent(buffer: Buffer) -> None:
    """As in RViz, frames within a millimetre of their parents have none."""
    send(buffer, "tool", "tip", x=0.0009)
    placed = place(buffer, "map", ["map", "base", "tool", "tip"], S)
    parents = {"map": None, "base": "map", "tool": "base", "tip": "tool"}
    rows = arrow_rows(placed.names, parents)
    points, kept = arrow_points(placed.xyz, *rows)
    assert [placed.names[row] for row in rows[0][kept]] == ["base", "tool"]
    assert points[kept].tolist() == [[[1, 0, 0], [0, 0, 0]], [[2, 0, 0], [1, 0, 0]]]


@given(st.tuples(*[st.floats(-3.1, 3.1)] * 3), st.tuples(*[st.floats(-1e3, 1e3)] * 3))
def test_places_are_the_poses_in_the_buffer(
    rpy: tuple[float, float, float], xyz: tuple[float, float, float]
) -> None:
    """For every pose."""
    buffer = Buffer()
    pose = Transform.from_rpy(*rpy, xyz=xyz)
    buffer.set_transform(TransformStamped(S, "map", "base", pose))
    placed = place(buffer, "map", ["base"], None)
    w, x, y, z = placed.quat_wxyz[0]
    assert Transform(placed.xyz[0], (x, y, z, w)).is_close(pose, 1e-7)


def test_a_trail_has_the_known_poses(buffer: Buffer) -> None:
    """Of the five seconds before 2 s only one is known: 31 points at 30 Hz."""
    path = trail(buffer, "map", "tool", 2 * S, 5.0)
    assert path.shape == (31, 3)
    assert np.all(path[:, 0] == 2.0)
    assert trail(buffer, "map", "nowhere", 2 * S, 5.0).shape == (0, 3)


def test_a_pause_holds_the_latest_time_at_which_all_can_be_placed(buffer: Buffer) -> None:
    """The pause is at the newest stamp of the slowest frame."""
    send(buffer, "map", "base", at_ns=9 * S)
    assert newest_common_ns(buffer, "map", ["map", "base", "tool", "nowhere"]) == 2 * S


# Choices


def test_following_shows_the_latest_and_scrubbing_a_time_before_the_pause() -> None:
    """The held time stays while the slider moves."""
    following = Playback()
    assert following.stamp_ns is None
    paused = following.pause(10 * S)
    assert paused.stamp_ns == 10 * S
    assert paused.pause(20 * S) == paused
    assert paused.scrub(20 * S, 1.5).stamp_ns == 8_500_000_000
    assert following.scrub(20 * S, 1.0).stamp_ns == 19 * S


def test_filters_take_names_by_regular_expressions() -> None:
    """`only` must match somewhere in the name, and `never` must not."""
    names = ["robot1/base", "robot1/camera_optical", "robot2/base"]
    only = NameFilter(only="^robot1", never="optical$")
    assert [name for name in names if only.takes(name)] == ["robot1/base"]
    assert all(map(NameFilter().takes, names))


def test_the_error_of_a_bad_regular_expression_says_what_is_wrong_and_where() -> None:
    """In one sentence, with the way to escape characters."""
    with pytest.raises(PatternError, match=r"'arm\(' .* character 4"):
        NameFilter(only="arm(")


def test_settings_are_read_as_they_were_saved(tmp_path: Path) -> None:
    """All of them."""
    settings = ViewSettings(
        fixed_frame="map", dark=True, scale=2.5, only="^robot", hidden=("a", "b/c"), trails=("d",)
    )
    save_settings(settings, tmp_path / "view.yaml")
    assert load_settings(tmp_path / "view.yaml") == settings


@pytest.mark.parametrize(
    ("written", "said"),
    [
        ("scale: big", "scale must be a number, got 'big'"),
        ("scale: 1000", "scale must be from 0.1 to 10, got 1000"),
        ("colour: red", "no setting 'colour'; available: arrows, axes, dark"),
        ("axes: 1", "axes must be true or false, got 1"),
        ("hidden: base", "hidden must be a list of names, got 'base'"),
        ("only: '('", "'(' is not a regular expression"),
        ("- a", "is not a map of settings"),
        ("a: [", "is not YAML"),
        ("[\n" * 5000, "nested too deeply"),
        (f"scale: {10**400}", "scale must be from 0.1 to 10, got inf"),
        ("topics: [{topic: a, color_min: .nan}]", "color_min must be a finite number or auto"),
    ],
)
def test_wrong_settings_are_refused_in_one_sentence(
    tmp_path: Path, written: str, said: str
) -> None:
    """It says what is wrong and what is allowed."""
    path = tmp_path / "view.yaml"
    path.write_text(written)
    with pytest.raises(SettingsError) as caught:
        load_settings(path)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_few_letters_that_stand_for_billions_of_values_are_refused() -> None:
    """A browser may send such a file: the error does not spell it out."""
    lines = ["- &a0 [x, x, x, x, x, x, x, x, x, x]"]
    lines += [f"- &a{n} [{', '.join(10 * [f'*a{n - 1}'])}]" for n in range(1, 6)]
    with pytest.raises(SettingsError) as caught:
        read_settings("\n".join(["hidden:", *lines]), "bomb.yaml")
    assert str(caught.value) == "bomb.yaml: hidden must be a list of names, got a list"


@pytest.mark.parametrize("written", ["a: 2001-13-45", "[\n" * 5000, "a: [", "- axes"])
def test_a_file_that_is_not_yaml_holds_no_settings(tmp_path: Path, written: str) -> None:
    """Whatever it is, it is read as the file that the user says it is."""
    (tmp_path / "zenoh.json5").write_text(written)
    assert not holds_settings(tmp_path / "zenoh.json5")


# Texts


def test_the_way_between_two_frames_is_written_as_by_echo(buffer: Buffer) -> None:
    """Distance and angle in one line, then tf2_echo's block."""
    turned = Transform.from_rpy(0.0, 0.0, -np.pi / 2, (0.0, 3.0, 4.0))
    buffer.set_transform(TransformStamped(2 * S, "base", "hook", turned))
    summary, block = between(buffer, "base", "hook", None)
    assert summary == "5.000 m apart, turned by 90.0°"
    assert block.startswith("At time 2.000000000\n- Translation: [0.000, 3.000, 4.000]")


def test_the_headline_says_what_the_page_waits_for() -> None:
    """Before any transform, and while the fixed frame is unknown."""
    assert "Waiting for transforms" in headline_of(Frames(), "", Playback())
    buffer = Buffer()
    send(buffer, "map", "base")
    assert "The first &lt;b&gt;." in headline_of(
        Frames(), "", Playback(), empty=nothing_recorded("the first <b>")
    )
    assert "no frame 'mop'" in headline_of(look(buffer, "mop"), "mop", Playback()).replace(
        "&#x27;", "'"
    )
    assert "2 frames, seen from <b>map</b>" in headline_of(look(buffer), "map", Playback())


def shown_text(stamp_ns: int, now_ns: int) -> str:
    """A clock time without its tooltip."""
    return re.sub("<[^>]*>", "", clock_time(stamp_ns, now_ns))


@pytest.fixture
def two_hours_east() -> Iterator[None]:
    """Local times are two hours ahead of UTC."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TZ", "UTC-2")
        time.tzset()
        yield
    time.tzset()


@pytest.mark.usefixtures("two_hours_east")
def test_stamps_are_clock_times() -> None:
    """With the date on another day; the tooltip has the stamp, and simulated time is seconds."""
    noon_ns = 1_649_160_000 * S
    assert shown_text(noon_ns + 661_570_822, noon_ns) == "14:00:00.661"
    assert shown_text(noon_ns, noon_ns + 86_400 * S) == "2022-04-05 14:00:00.000"
    assert shown_text(12_345_000_000, 13 * S) == "12.345 s"
    assert shown_text(2**63 - 1, noon_ns).startswith("2262-04-1")
    assert 'title="1649160000.000000000"' in clock_time(noon_ns, noon_ns)
    buffer = Buffer()
    send(buffer, "map", "base", at_ns=noon_ns)
    assert "14:00:00.000" in facts_of(look(buffer)["base"], noon_ns)
    paused = headline_of(look(buffer), "map", Playback(noon_ns), now_ns=noon_ns + 90 * S)
    assert re.search("paused</b> at <.*>14:00:00.000</span>, 90.0 s ago", paused)


def test_no_name_of_a_frame_becomes_markup() -> None:
    """Frames may have any name, such as that of a script."""
    buffer = Buffer()
    send(buffer, "<script>", "<b>&")
    frames = look(buffer, "<script>")
    assert "<script>" not in headline_of(frames, "<script>", Playback())
    assert "<b>&" not in facts_of(frames["<b>&"], S)
