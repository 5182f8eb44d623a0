"""rmw_zenoh's wire: keys, tokens, QoS, attachments and gids, with values of others."""

import struct

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from tfbus import InvalidNameError, SettingsError
from tfbus.ros.rmw_zenoh import (
    WIRES,
    Attachment,
    Qos,
    RosToken,
    Wire,
    attachment_bytes,
    check_node_name,
    check_topic_name,
    data_key,
    dds_type_name,
    gid_of,
    has_named_fields,
    read_attachment,
    read_token,
    ros_type_name,
    source_in,
    wire_of,
)

TYPE = "tf2_msgs::msg::dds_::TFMessage_"
HASH = "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087"

# Printed by pyzeros 0.1.0: the token of a publisher of its, and the gid that it makes of it.
TOKEN_TEXT = (
    "@ros2_lv/0/87e2d2e01e05996d45199bf10c120801/0/1/MP/%/%robot1/pyzeros_node/%tf/"
    f"{TYPE}/{HASH}/::,100:,:,:,,"
)
TOKEN_GID = "df0a0bd9760297a896d36df149368456"
TOKEN = RosToken(
    domain=0,
    session="87e2d2e01e05996d45199bf10c120801",
    node_number="0",
    number="1",
    kind="MP",
    node="pyzeros_node",
    namespace="/robot1",
    topic="/tf",
    dds_type=TYPE,
    type_hash=HASH,
    qos="::,100:,:,:,,",
)
# docs/design.md of rmw_zenoh has one of a node.
NODE_TEXT = "@ros2_lv/2/aac3178e146ba6f1fc6e6a4085e77f21/0/0/NN/%/%/listener"

ATTACHMENT = Attachment(7, 1_700_000_000_123_456_789, bytes(range(16)))
PLAIN = bytes.fromhex("070000000000000015cd853dfe9c971710000102030405060708090a0b0c0d0e0f")


class TestNames:
    """Keys and the names in them."""

    def test_the_key_of_a_topic_has_its_type_and_hash(self) -> None:
        """The name is without outer slashes."""
        assert data_key(0, "/tf", TYPE, HASH) == f"0/tf/{TYPE}/{HASH}"
        assert data_key(7, "/robot1/tf", TYPE, HASH) == f"7/robot1/tf/{TYPE}/{HASH}"

    def test_types_have_the_names_of_dds(self) -> None:
        """And back."""
        assert dds_type_name("tf2_msgs/msg/TFMessage") == TYPE
        assert ros_type_name(TYPE) == "tf2_msgs/msg/TFMessage"
        assert ros_type_name("TFMessage") == ""
        with pytest.raises(InvalidNameError, match="'TFMessage' is no type"):
            dds_type_name("TFMessage")

    @pytest.mark.parametrize("name", ["tf", "/", "/tf/", "//tf", "/a b", "/1a", "/a*", "/ä", ""])
    def test_names_that_ros_has_not_are_refused(self, name: str) -> None:
        """Also those that Zenoh takes for patterns."""
        check_topic_name("/robot1/tf_static")
        with pytest.raises(InvalidNameError, match="full name"):
            check_topic_name(name)

    def test_a_node_has_a_name_that_ros_takes(self) -> None:
        """And a namespace."""
        check_node_name("tfbus_ros2", "")
        check_node_name("tfbus_ros2", "fleet/robot1")
        for name, namespace in (("a-b", ""), ("a", "/robot1"), ("a", "r/"), ("", "")):
            with pytest.raises(InvalidNameError, match="no name in ROS"):
                check_node_name(name, namespace)


class TestTokens:
    """Tokens of the graph."""

    def test_a_token_is_that_of_others(self) -> None:
        """Made and read, with its gid."""
        assert TOKEN.text == TOKEN_TEXT
        assert read_token(TOKEN_TEXT) == TOKEN
        assert TOKEN.full_node_name == "/robot1/pyzeros_node"
        assert gid_of(TOKEN_TEXT).hex() == TOKEN_GID

    def test_the_token_of_a_node_has_no_topic(self) -> None:
        """In the root namespace."""
        node = RosToken(2, "aac3178e146ba6f1fc6e6a4085e77f21", "0", "0", "NN", "listener")
        assert node.text == NODE_TEXT
        assert read_token(NODE_TEXT) == node
        assert node.full_node_name == "/listener"

    def test_what_later_versions_append_is_passed_over(self) -> None:
        """As the backends of buffers since Lyrical."""
        assert read_token(f"{TOKEN_TEXT}/cpu") == TOKEN

    @pytest.mark.parametrize(
        "text",
        [
            "",
            "@ros2_lv",
            TOKEN_TEXT.replace("@ros2_lv", "ros2_lv"),
            TOKEN_TEXT.replace("/MP/", "/XX/"),
            TOKEN_TEXT.replace("/0/8", "/zero/8"),
            TOKEN_TEXT.replace("/0/8", "/٣/8"),
            TOKEN_TEXT.rpartition("/")[0],
            TOKEN_TEXT.replace("pyzeros_node", ""),
            TOKEN_TEXT.replace("pyzeros_node", "a\x1b[2J"),
            TOKEN_TEXT.replace("pyzeros_node", "a" * 5000),
        ],
    )
    def test_other_texts_are_no_tokens(self, text: str) -> None:
        """Strangers may declare what they like."""
        assert read_token(text) is None

    @given(
        st.text(max_size=60)
        | st.builds(
            "/".join,
            st.lists(
                st.sampled_from(["@ros2_lv", "0", "MP", "NN", "%", "", "a", "%tf", "*"]),
                max_size=15,
            ),
        )
    )
    @example(TOKEN_TEXT)
    def test_a_token_that_is_read_is_written_the_same(self, text: str) -> None:
        """Whatever it is, nothing is raised."""
        token = read_token(text)
        if token is not None:
            assert read_token(token.text) == token


class TestQos:
    """QoS as it stands in tokens."""

    @pytest.mark.parametrize(
        "qos, text",
        [
            (Qos(), "::,:,:,:,,"),
            (Qos(depth=100), "::,100:,:,:,,"),
            (Qos(retained=True, depth=1), ":1:,1:,:,:,,"),
            (Qos(depth=5, reliable=False), "2::,5:,:,:,,"),
            (Qos(depth=None), "::2,:,:,:,,"),
        ],
    )
    def test_defaults_are_left_out(self, qos: Qos, text: str) -> None:
        """rmw_zenoh's own: reliable, volatile, the last 42."""
        assert qos.text == text


class TestAttachments:
    """What comes with each message."""

    def test_33_bytes(self) -> None:
        """A number, a stamp, and a gid after its length."""
        assert attachment_bytes(ATTACHMENT) == PLAIN
        assert read_attachment(PLAIN) == ATTACHMENT
        assert not has_named_fields(PLAIN)

    def test_before_0_2_4_the_fields_have_names(self) -> None:
        """Each behind its length, as Zenoh serializes texts."""
        named = (
            b"\x0fsequence_number"
            + PLAIN[:8]
            + b"\x10source_timestamp"
            + PLAIN[8:16]
            + b"\x0asource_gid"
            + PLAIN[16:]
        )
        assert attachment_bytes(ATTACHMENT, named=True) == named
        assert len(named) == 77
        assert read_attachment(named) == ATTACHMENT
        assert has_named_fields(named)

    @pytest.mark.parametrize("named", [False, True])
    def test_all_messages_of_a_publisher_name_it_by_the_same_bytes(self, named: bool) -> None:
        """And those of another by others."""
        sources = [
            source_in(
                attachment_bytes(Attachment(number, 7 * number, bytes([of] * 16)), named=named)
            )
            for of in (1, 2)
            for number in (1, 2**40)
        ]
        assert sources[0] == sources[1] != sources[2] == sources[3]

    def test_what_later_versions_append_is_passed_over(self) -> None:
        """As C++'s reader does."""
        assert read_attachment(PLAIN + b"more") == ATTACHMENT

    @pytest.mark.parametrize(
        "data",
        [
            b"",
            PLAIN[:32],
            PLAIN[:16] + b"\x18" + bytes(24),
            b"\x0fsequence_number" + PLAIN,
            b"\x0fsequence_number" + bytes(61),
        ],
    )
    def test_other_bytes_are_none(self, data: bytes) -> None:
        """Too short, or a gid of another size, or other names."""
        assert read_attachment(data) is None

    @given(st.binary(max_size=100))
    def test_nothing_is_raised(self, data: bytes) -> None:
        """What is read has a gid of 16 bytes."""
        read = read_attachment(data)
        assert read is None or len(read.gid) == 16

    @given(st.integers(-(2**63), 2**63 - 1), st.integers(-(2**63), 2**63 - 1), st.booleans())
    def test_numbers_come_back(self, sequence: int, stamp_ns: int, named: bool) -> None:
        """All of 64 bits."""
        attachment = Attachment(sequence, stamp_ns, struct.pack("<2q", stamp_ns, sequence))
        assert read_attachment(attachment_bytes(attachment, named=named)) == attachment


class TestDistributions:
    """What differs between them."""

    def test_the_present_wire_is_the_default(self) -> None:
        """And that of Jazzy and later ones."""
        assert all(wire_of(each) == Wire() for each in ("", "jazzy", "kilted", "rolling"))
        assert wire_of("humble") == Wire(has_type_hashes=False)
        assert wire_of("jazzy-0.2.3") == Wire(has_named_fields=True)
        assert all(wire_of(each) for each in WIRES)

    def test_an_unknown_one_is_an_error(self) -> None:
        """It names what is near."""
        with pytest.raises(SettingsError, match=r"'humbel'.*'humble'"):
            wire_of("humbel")
        with pytest.raises(SettingsError, match="available: humble, jazzy"):
            wire_of("iron")
