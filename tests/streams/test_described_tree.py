"""The streams that a lookup needs, by the frames that all streams list."""

from hypothesis import given
from hypothesis import strategies as st

from tests.builders import Row, description
from tfbus.streams.interest import DescribedTree, described_edges
from tfbus.wire.fleet import FrameNames


def dynamic(*edges: str) -> list[Row]:
    """Dynamic rows of edges written as `map>odom`."""
    return [(*_ends(edge), False) for edge in edges]


def fixed(*edges: str) -> list[Row]:
    """Static rows of edges written as `base>lidar`."""
    return [(*_ends(edge), True) for edge in edges]


def _ends(edge: str) -> tuple[str, str]:
    parent, child = edge.split(">")
    return parent, child


def tree_of(**streams: list[Row]) -> DescribedTree:
    """The tree that these streams describe."""
    tree = DescribedTree()
    for stream, rows in streams.items():
        tell(tree, stream, rows)
    return tree


def tell(tree: DescribedTree, stream: str, rows: list[Row], *, alive: bool = True) -> None:
    """Let a stream describe itself again."""
    edges = described_edges(stream, f"@tfbus/stream/{stream}", description(rows))
    tree.update(stream, edges, alive=alive)


def keys_needed(tree: DescribedTree, *pairs: tuple[str, str]) -> set[str]:
    """The keys that lookups between the pairs need."""
    return {edge.key for edge in tree.edges_needed(pairs)}


ROBOT = {
    "slam": dynamic("map>odom"),
    "wheels": dynamic("odom>base"),
    "model": fixed("base>lidar", "base>arm"),
    "arm": dynamic("arm>elbow", "elbow>tool"),
}


def test_a_lookup_needs_the_streams_of_its_path() -> None:
    """A lookup needs the keys from the source up to the target, and no others."""
    tree = tree_of(**ROBOT)
    assert keys_needed(tree, ("odom", "base")) == {"tf/wheels"}
    assert keys_needed(tree, ("map", "lidar")) == {"tf/slam", "tf/wheels", "tf_static/model"}
    assert keys_needed(tree, ("tool", "elbow")) == {"tf/arm"}


def test_two_branches_meet_below_the_root() -> None:
    """What is above the lowest frame that both ends are below is not needed."""
    tree = tree_of(**ROBOT)
    assert keys_needed(tree, ("lidar", "tool")) == {"tf_static/model", "tf/arm"}
    assert keys_needed(tree, ("lidar", "arm")) == {"tf_static/model"}


def test_frames_that_nothing_joins_need_all_above_them() -> None:
    """Between trees that are not connected, all up to both roots is needed."""
    tree = tree_of(
        left=dynamic("world>a", "a>b"), right=dynamic("floor>c"), other=dynamic("world>d")
    )
    assert not tree.are_connected("b", "c")
    assert (tree.roots("b"), tree.roots("c")) == (["world"], ["floor"])
    assert keys_needed(tree, ("b", "c")) == {"tf/left", "tf/right"}
    tell(tree, "joint", dynamic("world>floor"))
    assert tree.are_connected("b", "c")
    assert keys_needed(tree, ("b", "c")) == {"tf/left", "tf/right", "tf/joint"}


def test_frames_that_no_stream_describes_need_nothing() -> None:
    """For a frame that no stream describes there is nothing to read."""
    tree = tree_of(**ROBOT)
    assert keys_needed(tree, ("map", "nowhere")) == set()
    assert keys_needed(DescribedTree(), ("map", "base")) == set()


def test_a_frame_is_seen_from_itself() -> None:
    """A lookup of a frame in itself needs the frame."""
    assert "tf/wheels" in keys_needed(tree_of(**ROBOT), ("base", "base"))


def test_the_path_follows_a_frame_to_another_parent() -> None:
    """A frame that gets another parent has another path up."""
    tree = tree_of(
        table=dynamic("room>table"), robot=dynamic("room>hand"), cup=dynamic("table>cup")
    )
    assert keys_needed(tree, ("room", "cup")) == {"tf/table", "tf/cup"}
    tell(tree, "cup", dynamic("hand>cup"))
    assert keys_needed(tree, ("room", "cup")) == {"tf/robot", "tf/cup"}


def test_the_path_follows_a_frame_to_another_stream() -> None:
    """A frame that another stream sends from now on is read there."""
    tree = tree_of(old=dynamic("map>base"))
    tell(tree, "new", dynamic("map>base"))
    tell(tree, "old", [])
    assert keys_needed(tree, ("map", "base")) == {"tf/new"}
    tell(tree, "new", dynamic("odom>base"))
    assert [frame for frame in ("map", "odom", "base") if tree.describes(frame)] == ["odom", "base"]
    assert tree.frames() == {"odom", "base"}


def test_a_gone_stream_is_read_where_no_other_sends_its_frame() -> None:
    """A gone stream may come back, so it is needed, except where another sends its frame."""
    tree = tree_of(old=dynamic("map>base"))
    tell(tree, "old", dynamic("map>base"), alive=False)
    assert keys_needed(tree, ("map", "base")) == {"tf/old"}
    tell(tree, "new", dynamic("odom>base"))
    assert keys_needed(tree, ("odom", "base")) == {"tf/new"}


def test_where_streams_disagree_all_ways_are_needed() -> None:
    """Two parents of one frame need everything above both, since either may count."""
    tree = tree_of(
        one=dynamic("a>x"), two=dynamic("b>x"), top=dynamic("root>a", "root>b"), end=dynamic("a>y")
    )
    assert keys_needed(tree, ("y", "x")) == {"tf/one", "tf/two", "tf/top", "tf/end"}


def test_where_streams_agree_about_the_parent_the_way_is_one() -> None:
    """Two publishers of one edge are both needed, but nothing above it."""
    tree = tree_of(one=dynamic("a>x"), two=dynamic("a>x"), top=dynamic("root>a"))
    assert keys_needed(tree, ("a", "x")) == {"tf/one", "tf/two"}


def test_parents_in_a_circle_do_no_harm() -> None:
    """A circle that streams describe ends the walk up."""
    tree = tree_of(one=dynamic("a>b"), two=dynamic("b>a"))
    assert keys_needed(tree, ("a", "b")) <= {"tf/one", "tf/two"}
    assert tree.roots("a") == []


def test_a_split_stream_is_needed_frame_by_frame() -> None:
    """Of a stream that sends each frame on a key of its own, only the keys needed are read; its
    static transforms are one set.
    """
    tree = DescribedTree()
    rows = dynamic("map>a/1", "a/1>b", "map>c") + fixed("b>d")
    key = "@tfbus/stream/many"
    tree.update("many", described_edges("many", key, description(rows, split=True)), alive=True)
    assert keys_needed(tree, ("map", "b")) == {"tf/many/a%2F1", "tf/many/b"}
    assert keys_needed(tree, ("b", "d")) == {"tf_static/many"}


def test_the_frames_of_a_robot_are_found_by_their_outside_names() -> None:
    """Seen from outside, keys and frames have the robot's namespace in front."""
    tree = DescribedTree()
    names = FrameNames("robot7", ("map",))
    for stream, split in (("sim", False), ("arm", True)):
        rows = dynamic("map>base") if stream == "sim" else dynamic("base>arm")
        key = f"robot7/@tfbus/stream/{stream}"
        described = description(rows, split=split)
        tree.update(f"robot7/{stream}", described_edges(stream, key, described, names), alive=True)
    assert tree.frames() == {"map", "robot7/base", "robot7/arm"}
    assert keys_needed(tree, ("map", "robot7/arm")) == {"robot7/tf/sim", "robot7/tf/arm/arm"}


@st.composite
def forests(draw: st.DrawFn) -> dict[str, str]:
    """Parents by their children: frame n hangs below a frame of a lower number, or is a root."""
    count = draw(st.integers(2, 12))
    parents = {}
    for child in range(1, count):
        parent = draw(st.none() | st.integers(0, child - 1))
        if parent is not None:
            parents[str(child)] = str(parent)
    return parents


def _chain(parents: dict[str, str], frame: str) -> list[str]:
    chain = [frame]
    while chain[-1] in parents:
        chain.append(parents[chain[-1]])
    return chain


@given(forests(), st.integers(0, 11), st.integers(0, 11))
def test_what_is_needed_joins_the_frames_and_nothing_of_it_is_idle(
    parents: dict[str, str], target: int, source: int
) -> None:
    """For any tree the edges needed are those between the two frames, and no others."""
    streams = {f"s{child}": dynamic(f"{parent}>{child}") for child, parent in parents.items()}
    tree = tree_of(**streams)
    ups, downs = _chain(parents, str(source)), _chain(parents, str(target))
    needed = {edge.child for edge in tree.edges_needed([(str(target), str(source))])}
    if target != source:
        expected = set(ups) ^ set(downs) if ups[-1] == downs[-1] else set(ups) | set(downs)
        assert needed == expected & parents.keys()
    assert tree.are_connected(str(target), str(source)) == (ups[-1] == downs[-1])


def test_only_the_last_gone_streams_are_remembered() -> None:
    """At most 1000 gone streams are remembered."""
    tree = DescribedTree()
    for number in range(1100):
        tell(tree, f"s{number}", dynamic(f"map>f{number}"), alive=False)
    assert len(tree.frames()) == 1001
    assert keys_needed(tree, ("map", "f0")) == set()
    assert keys_needed(tree, ("map", "f1099")) == {"tf/s1099"}
