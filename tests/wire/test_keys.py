"""Names and keys: every name of a user becomes a key that Zenoh takes, and comes back."""

import re
from typing import Any

import pytest
import zenoh
from hypothesis import given
from hypothesis import strategies as st

from tfbus import InvalidNameError
from tfbus.wire import keys

names = st.text(st.characters(exclude_categories=["Cs"]), min_size=1)
awkward = st.text("%*$?#/@ \t\n\x00%2Fab", min_size=1)


@given(names | awkward)
def test_any_name_is_one_chunk_and_comes_back(name: str) -> None:
    """Any name becomes one chunk of a key, and the chunk gives the name back."""
    chunk = keys.escape(name)
    assert "/" not in chunk
    assert keys.unescape(chunk) == name


@given(names | awkward)
def test_zenoh_takes_every_key(name: str) -> None:
    """Zenoh takes the keys of any stream, node and parameter, and none of them is a wild card."""
    for key in (
        keys.transforms_key(name),
        keys.static_transforms_key(name),
        keys.stream_key(name),
        keys.node_key(name),
        keys.parameter_key(name, name),
    ):
        assert str(zenoh.KeyExpr(key)) == key
        assert not set("*$") & set(key)
        assert keys.last_name(key) == name


@given(st.tuples(names | awkward, names | awkward).filter(lambda pair: pair[0] != pair[1]))
def test_two_names_have_two_keys(pair: tuple[str, str]) -> None:
    """Names that differ have keys that differ."""
    assert keys.stream_key(pair[0]) != keys.stream_key(pair[1])


@given(names | awkward)
def test_the_wild_keys_hold_each_key(name: str) -> None:
    """A key expression for all streams or nodes holds the key of each of them."""
    for every, key in (
        (keys.ALL_TRANSFORMS, keys.transforms_key(name)),
        (keys.ALL_STATIC_TRANSFORMS, keys.static_transforms_key(name)),
        (keys.ALL_STREAMS, keys.stream_key(name)),
        (keys.ALL_NODES, keys.node_key(name)),
        (keys.node_parameters_key(name), keys.parameter_key(name, name)),
    ):
        assert zenoh.KeyExpr(every).includes(zenoh.KeyExpr(key))


def test_the_keys_are_those_of_the_wire_format() -> None:
    """The keys are what others rely on."""
    assert keys.transforms_key("broadcaster1") == "tf/broadcaster1"
    assert keys.static_transforms_key("camera/left") == "tf_static/camera%2Fleft"
    assert keys.stream_key("sim") == "@tfbus/stream/sim"
    assert keys.node_key("sim") == "@tfbus/node/sim"
    assert keys.parameter_key("sim", "background_r") == "@tfbus/param/sim/background_r"


@pytest.mark.parametrize(
    ("key", "stream"),
    [
        ("tf/sim", "sim"),
        ("tf_static/camera%2Fleft", "camera/left"),
        ("robot7/tf/sim", "robot7/sim"),
        ("lab/robot7/tf_static/sim", "lab/robot7/sim"),
        ("robot7/tf_static/tf", "robot7/tf"),
        ("lab/@tfbus/stream/tf", "lab/tf"),
        ("elsewhere", "elsewhere"),
        ("tf", ""),
    ],
)
def test_a_key_tells_its_stream(key: str, stream: str) -> None:
    """The stream is what follows tf or tf_static; a namespace in front stays part of it."""
    assert keys.stream_of(key) == stream


_ROS_TF = "tf2_msgs::msg::dds_::TFMessage_/RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8"


@pytest.mark.parametrize(
    "key",
    [
        "tf",
        "tf_static",
        "bot1/tf",
        "rt/tf_static",
        f"0/tf/{_ROS_TF}",
        f"0/tf_static/{_ROS_TF}",
        f"7/lab/robot1/tf/{_ROS_TF}",
        f"robot1/tf/{_ROS_TF}",
        "0/tf/tf2_msgs::msg::dds_::TFMessage_/TypeHashNotSupported",
        "0/tf/state/std_msgs::msg::dds_::String_/RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db128",
        "0/tf_static/info/std_msgs::msg::dds_::String_/RIHS01_df668c740482bbd48fb39d76a70dfd4b",
    ],
)
def test_keys_of_ros_2_are_foreign(key: str) -> None:
    """They match the expressions for transforms, and are none of a stream's."""
    every = [keys.ALL_TRANSFORMS_EVERYWHERE, keys.ALL_STATIC_TRANSFORMS_EVERYWHERE]
    assert any(zenoh.KeyExpr(each).intersects(zenoh.KeyExpr(key)) for each in every)
    assert keys.is_foreign(key)


@given(names | awkward, names | awkward)
def test_keys_of_streams_are_not_foreign(name: str, child: str) -> None:
    """The keys of each name that a stream can have are its own, and it has no other name."""
    token = f"lab/robot7/{keys.stream_key(name)}"
    own = [
        keys.transforms_key(name),
        keys.static_transforms_key(name),
        keys.transforms_key_beside(token, child),
        keys.static_transforms_key_beside(token),
    ]
    if not keys.mistake_in_stream(name):
        assert not any(map(keys.is_foreign, own))


def test_names_that_no_stream_can_have() -> None:
    """A mistake says what is allowed."""
    assert keys.mistake_in_stream("ros2/robot_state_publisher") == ""
    assert "1 to 255 letters" in keys.mistake_in_stream("")
    said = keys.mistake_in_stream("tf2_msgs::msg::dds_::TFMessage_")
    assert said.startswith("'::dds_::' ") and "ROS 2" in said


@pytest.mark.parametrize(
    ("key", "namespace"),
    [
        ("tf/sim", ""),
        ("robot7/tf/sim/base", "robot7"),
        ("lab/robot7/tf_static/tf", "lab/robot7"),
        ("robot7/@tfbus/stream/sim", "robot7"),
    ],
)
def test_a_key_tells_its_namespace(key: str, namespace: str) -> None:
    """The namespace is what is in front of tf, tf_static or @tfbus."""
    assert keys.namespace_of(key) == namespace


@given(names | awkward)
def test_the_data_of_a_stream_is_beside_its_token(name: str) -> None:
    """The keys of a stream's transforms follow from the key of its token, in its namespace."""
    for namespace in ("", "lab/robot7/"):
        token = f"{namespace}{keys.stream_key(name)}"
        whole = f"{namespace}{keys.transforms_key(name)}"
        assert keys.transforms_key_beside(token) == whole
        assert keys.transforms_key_beside(token, "arm/left") == f"{whole}/arm%2Fleft"
        static = f"{namespace}{keys.static_transforms_key(name)}"
        assert keys.static_transforms_key_beside(token) == static


@pytest.mark.parametrize(
    ("key", "namespace", "name"),
    [
        ("@tfbus/node/sim", "", "/sim"),
        ("@tfbus/node/sim", "robot7", "/robot7/sim"),
        ("robot7/@tfbus/node/sim", "", "/robot7/sim"),
        ("robot7/@tfbus/node/sim", "lab", "/lab/robot7/sim"),
    ],
)
def test_a_key_tells_the_full_name_of_a_node(key: str, namespace: str, name: str) -> None:
    """A node's full name begins with '/' and holds its whole namespace."""
    assert keys.full_name(key, namespace) == name


@pytest.mark.parametrize("name", ["sim", "turtle1", "cam-left", "a.b", "_x", "7"])
def test_node_names(name: str) -> None:
    """A node's name is letters, digits, '_', '-' and '.'."""
    assert keys.check_node_name(name) == name


@pytest.mark.parametrize("name", ["", "-x", ".x", "a b", "é", "a*", "a\n", "@tfbus"])
def test_names_that_no_node_can_have(name: str) -> None:
    """A name that no node can have is refused with what is allowed."""
    said = re.escape(f"{name!r} cannot be a node's name")
    with pytest.raises(InvalidNameError, match=f"^{said}: use letters, digits"):
        keys.check_node_name(name)


def test_a_node_name_with_a_slash_points_to_the_namespace() -> None:
    """A node's name with a slash is refused with where the namespace goes."""
    with pytest.raises(InvalidNameError, match="--namespace"):
        keys.check_node_name("robot7/sim")


@pytest.mark.parametrize("name", ["pose", "turtle1/pose", "a b".replace(" ", "_"), "ü/ö", "a%2Fb"])
def test_topics(name: str) -> None:
    """A topic is a relative path."""
    assert keys.check_topic(name) == name
    assert str(zenoh.KeyExpr(name)) == name


@pytest.mark.parametrize("name", ["", "a//b", "a/", "a b", "a/*", "a$b", "a?b", "a#b", "@tfbus/x"])
def test_names_that_no_topic_can_have(name: str) -> None:
    """A topic with an empty part, white space, or a character of Zenoh's is refused."""
    said = re.escape(f"{name!r} cannot be")
    with pytest.raises(InvalidNameError, match=rf"^{said} .*a topic: .* \* \$ \? #$"):
        keys.check_topic(name)


def test_an_absolute_topic_is_one() -> None:
    """A topic may have ROS's leading slash."""
    assert keys.check_topic("/turtle1/pose") == "/turtle1/pose"


@pytest.mark.parametrize("name", ["~", "~/pose"])
def test_a_private_name_belongs_to_a_node(name: str) -> None:
    """Without a node the name behind `~` is unknown: the error says what to write."""
    with pytest.raises(InvalidNameError, match="instead of '~'"):
        keys.check_topic(name)


@pytest.mark.parametrize("name", ["a\x1b[2J", "a\u202eb", "caf\udce9", "a\x00"])
def test_a_topic_can_be_printed(name: str) -> None:
    """A control character or a lone surrogate is refused, and escaped in the error."""
    with pytest.raises(InvalidNameError) as caught:
        keys.check_topic(name)
    assert str(caught.value).isprintable()


@pytest.mark.parametrize("check", [keys.check_topic, keys.check_parameter])
def test_a_name_is_a_text(check: Any) -> None:
    """A name of another type is refused in one sentence."""
    with pytest.raises(InvalidNameError, match="a str, not int"):
        check(7)


@pytest.mark.parametrize(
    ("name", "namespace", "resolved"),
    [
        ("pose", "", "pose"),
        ("/pose", "", "pose"),
        ("/turtle1/pose", "", "turtle1/pose"),
        ("pose", "robot7", "pose"),
        ("/pose", "robot7", "/pose"),
        ("/robot7/pose", "robot7", "pose"),
        ("/robot77/pose", "robot7", "/robot77/pose"),
        ("/robot7", "robot7", "/robot7"),
        ("/fleet/robot7/pose", "fleet/robot7", "pose"),
        ("~/pose", "", "sim/pose"),
        ("~/pose", "robot7", "sim/pose"),
    ],
)
def test_names_are_resolved_as_in_ros(name: str, namespace: str, resolved: str) -> None:
    """A slash begins a name outside of the namespace, and `~` stands for the node."""
    assert keys.resolve(name, "sim", namespace) == resolved


@given(st.text(max_size=8) | awkward)
def test_zenoh_takes_every_topic_that_is_allowed(name: str) -> None:
    """What passes as a topic is a key that Zenoh takes as it is."""
    try:
        keys.check_topic(name)
    except InvalidNameError:
        return
    assert str(zenoh.KeyExpr(name.removeprefix("/"))) == name.removeprefix("/")


@pytest.mark.parametrize(
    ("given", "kept"), [("", ""), ("/", ""), ("robot7", "robot7"), ("/lab/robot7/", "lab/robot7")]
)
def test_namespaces(given: str, kept: str) -> None:
    """A namespace may be written with slashes around it."""
    assert keys.check_namespace(given) == kept


@pytest.mark.parametrize("namespace", ["a//b", "//a", "a//", "a b", "robot*", "@tfbus"])
def test_namespaces_that_cannot_be(namespace: str) -> None:
    """A namespace follows the rules of a topic."""
    with pytest.raises(InvalidNameError, match="name of a namespace"):
        keys.check_namespace(namespace)


@pytest.mark.parametrize("namespace", ["~", "~/a", "/a/~"])
def test_a_namespace_is_not_a_nodes_own(namespace: str) -> None:
    """`~` is for the names of topics alone."""
    with pytest.raises(InvalidNameError, match="a namespace: '~'"):
        keys.check_namespace(namespace)


@pytest.mark.parametrize("namespace", ["tf", "/lab/tf_static", "tf/robot7"])
def test_a_namespace_has_no_part_that_is_a_key_of_transforms(namespace: str) -> None:
    """The keys of its streams would be read as others', and its topics as transforms."""
    with pytest.raises(InvalidNameError, match="the keys of transforms"):
        keys.check_namespace(namespace)


@pytest.mark.parametrize("topic", ["tf", "tf/sim", "tf_static", "/robot7/tf/sim", "a/tf_static/b"])
def test_the_keys_of_transforms_are_no_topics_of_messages(topic: str) -> None:
    """Listeners would read a message there as transforms."""
    with pytest.raises(InvalidNameError, match="is of transforms"):
        keys.check_no_transforms(topic)
    assert keys.check_no_transforms("tfx/a_tf") == "tfx/a_tf"
