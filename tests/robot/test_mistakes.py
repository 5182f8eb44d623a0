"""Mistakes in a URDF: one sentence each, with the line and the name of the element."""

import random
import re
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.builders import examples
from tests.robot.robots import ARM, HOVERCRAFT
from tfbus import InvalidArgumentException, Robot, UrdfError

LINKS = "<link name='a'/><link name='b'/><link name='c'/>"


def joint(name: str, parent: str, child: str, more: str = "", kind: str = "continuous") -> str:
    """A joint in one line."""
    return (
        f"<joint name='{name}' type='{kind}'><parent link='{parent}'/><child link='{child}'/>"
        f"{more}</joint>\n"
    )


def robot(inside: str) -> str:
    """A URDF whose second line begins with this."""
    return f"<robot name='r'>\n{inside}</robot>"


def visual(geometry: str) -> str:
    """A URDF with a visual."""
    return robot(f"<link name='a'><visual><geometry>{geometry}</geometry></visual></link>")


Z = "<axis xyz='0 0 1'/>"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "1: not XML: no element found"),
        ("robot", "1: not XML: syntax error"),
        ("<robot>\n<link name='a'>", "2: not XML: no element found"),
        ("<robot>\n<link name='a'></robot>", "2: not XML: mismatched tag"),
        ("<sdf/>", "1: not a URDF: its root element is <sdf>, not <robot>"),
        ("<robot/>", "1: the robot has no <link>"),
        (
            robot("<xacro:arm/>"),
            "2: <xacro:arm> is xacro; name the file .xacro, or expand it first",
        ),
        # The tree
        (
            robot(LINKS),
            "1: 3 links have no parent: 'a', 'b', 'c'; all links but one must be the child of a "
            "joint",
        ),
        (
            robot(LINKS + joint("j", "a", "b", Z)),
            "1: 2 links have no parent: 'a', 'c'; all links but one must be the child of a joint",
        ),
        (
            robot(LINKS + joint("j", "a", "b", Z) + joint("k", "c", "b", Z)),
            "3: joint 'k': link 'b' is already the child of joint 'j'; a link has one parent",
        ),
        (
            robot(LINKS + "\n" + joint("j", "b", "c", Z) + joint("k", "c", "b", Z)),
            "4: joint 'k' closes a cycle of links: 'b' -> 'c' -> 'b'",
        ),
        (
            robot("<link name='a'/>" + joint("j", "a", "a", Z)),
            "2: joint 'j': link 'a' is its parent and its child",
        ),
        (
            robot("<link name='base'/>" + joint("j", "bass", "base", Z)),
            "2: joint 'j': no link 'bass'; did you mean 'base'?",
        ),
        (
            robot("<link name='a'/><joint name='j' type='fixed'/>"),
            "2: joint 'j': no <parent link=..",
        ),
        # Names
        (robot("<link/>"), "2: the name of a <link> must not be empty"),
        (robot("<link name='/a'/>"), "2: the name of a <link> '/a' begins with a slash; write 'a'"),
        (robot("<link name='a'/>\n<link name='a'/>"), "3: a second link 'a'; names must differ"),
        (
            robot(LINKS + joint("j", "a", "b", Z) + joint("j", "a", "c", Z)),
            "3: a second joint 'j'; names must differ",
        ),
        # Joints
        (
            robot(LINKS + joint("j", "a", "b", kind="ball")),
            "2: joint 'j': type 'ball' is none; allowed are 'revolute', 'continuous', 'prismatic', "
            "'planar', 'floating', 'fixed'",
        ),
        (robot(LINKS + joint("j", "a", "b", kind="")), "2: joint 'j': has no type; allowed are"),
        (
            robot(LINKS + joint("j", "a", "b", "\n<axis xyz='0 0 0'/>")),
            "3: joint 'j': axis 0 0 0 has no direction; such as 0 0 1",
        ),
        (
            robot(LINKS + joint("j", "a", "b", "\n<axis/>")),
            "3: joint 'j': xyz of <axis> must be 3 finite numbers, it is missing",
        ),
        (
            robot(LINKS + joint("j", "a", "b", "\n<origin xyz='0 nan 0'/>")),
            "3: joint 'j': xyz of <origin> must be 3 finite numbers, got '0 nan 0'",
        ),
        (
            robot(LINKS + joint("j", "a", "b", "\n<origin rpy='0, 1e999, 0'/>")),
            "3: joint 'j': rpy of <origin> must be 3 finite numbers, got '0, 1e999, 0'; separate "
            "them with spaces",
        ),
        (
            robot(LINKS + joint("j", "a", "b", "<limit lower='a'/>", "revolute")),
            "2: joint 'j': lower of <limit> must be 1 finite number, got 'a'",
        ),
        # Mimics
        (
            robot(LINKS + joint("j", "a", "b", Z) + joint("k", "a", "c", Z + "<mimic joint='i'/>")),
            "3: joint 'k' mimics no joint 'i'; available: j",
        ),
        (
            robot("<link name='a'/><link name='b'/>" + joint("j", "a", "b", "<mimic joint='j'/>")),
            "2: joint 'j' mimics a cycle: 'j' -> 'j'",
        ),
        (
            robot(
                LINKS
                + joint("j", "a", "b", Z + "<mimic joint='k'/>")
                + joint("k", "a", "c", Z + "<mimic joint='j'/>")
            ),
            "2: joint 'j' mimics a cycle: 'j' -> 'k' -> 'j'",
        ),
        (
            robot(
                LINKS
                + joint("j", "a", "b", kind="fixed")
                + joint("k", "a", "c", Z + "<mimic joint='j'/>")
            ),
            "3: joint 'k' mimics joint 'j', which is fixed: it has no single position",
        ),
        (
            robot(LINKS + joint("j", "a", "b", "<mimic joint='k'/>", "floating")),
            "2: joint 'j': a floating joint cannot mimic another",
        ),
        # Shapes
        (
            visual("<box size='1 2'/>"),
            "2: visual of link 'a': size of <box> must be 3 finite numbers, got '1 2'",
        ),
        (visual("<sphere radius='-1'/>"), "2: visual of link 'a': radius -1 is negative"),
        (visual(""), "2: visual of link 'a': no box, cylinder, sphere or mesh"),
        (visual("<mesh/>"), "2: visual of link 'a': <mesh> has no filename"),
        (
            visual("<mesh filename='package://p/../../etc/passwd'/>"),
            "2: visual of link 'a': mesh 'package://p/../../etc/passwd' leads out of package 'p'",
        ),
        # What XML allows and a robot does not need
        (
            '\n<!DOCTYPE r [<!ENTITY a "b">]><robot/>',
            "2: its DOCTYPE has declarations between [ and ]; entities and default attributes are "
            "not allowed in a URDF: write out what they stand for",
        ),
        (
            '<!DOCTYPE r [<!ENTITY a SYSTEM "file:///etc/passwd">]><robot>&a;</robot>',
            "1: its DOCTYPE has declarations",
        ),
        (
            '<!DOCTYPE r [<!ATTLIST x y CDATA "long">]><robot><x/></robot>',
            "1: its DOCTYPE has declarations",
        ),
        ("<a>" * 101, "1: more than 100 elements in each other: not a robot"),
        (robot("<a/>" * 100_000), "2: more than 100000 elements: not a robot"),
        ("<robot>\ud800</robot>", "<text> is not text: it contains half a character"),
        ("<robot>" + " " * 20_000_000, "<text> has 20 MB; at most 20 MB are read"),
    ],
)
def test_a_mistake_has_its_line_and_its_name(text: str, said: str) -> None:
    """In one sentence, without a traceback of a reader's."""
    with pytest.raises(UrdfError) as caught:
        Robot.from_text(text)
    sentence = str(caught.value)
    assert sentence.removeprefix("<text>:").startswith(said)
    assert "\n" not in sentence


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            robot("<link name='a'/><link name='b'/>\n" + joint("j", "a", "b")),
            "<text>:3: joint 'j': no <axis>; the default of URDF is used, 1 0 0",
        ),
        (
            robot("<link name='a'/><link name='b'/>\n" + joint("j", "a", "b", Z, "revolute")),
            "<text>:3: joint 'j': no <limit>; it is not limited",
        ),
        (
            "<robot name='r'>\n<link name='a'><visual><geometry><sphere radius='1'/></geometry>"
            "<material name='gren'/></visual></link></robot>",
            "<text>:2: visual of link 'a': no <material> defines 'gren'; it has no colour",
        ),
        (
            visual("<plane/>"),
            "<text>:2: visual of link 'a': <plane> is none of box, cylinder, sphere and mesh; it "
            "is left out",
        ),
    ],
)
def test_what_a_urdf_leaves_out_is_a_warning(text: str, said: str) -> None:
    """The robot is there, and says how it was read."""
    assert Robot.from_text(text).warnings == (said,)


def test_limits_the_wrong_way_round_are_none() -> None:
    """As Bullet's users write them for a joint without limits."""
    limit = "<limit lower='1' upper='-1'/>"
    found = Robot.from_text(
        robot("<link name='a'/><link name='b'/>" + joint("j", "a", "b", Z + limit, "prismatic"))
    )
    assert re.search("lower limit 1 .* limit -1; .*not limited", found.warnings[0])
    limits = found.joints["j"].limits
    assert limits and limits.lower == -limits.upper == float("-inf")


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"<robot name='\xff'/>", r"robot\.urdf:1: not utf-8 \(invalid start byte\)"),
        (b"<?xml version='1.0' encoding='rot13'?><robot/>", "encoding 'rot13' is not supported"),
        (b"\xff\xfe<", r"robot\.urdf:1: not utf-16"),
        (b"", r"robot\.urdf:1: not XML: no element found"),
    ],
)
def test_bytes_that_are_no_text_are_refused(tmp_path: Path, data: bytes, said: str) -> None:
    """With what to do."""
    (tmp_path / "robot.urdf").write_bytes(data)
    with pytest.raises(UrdfError, match=said):
        Robot.from_urdf(tmp_path / "robot.urdf")


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16", "iso-8859-1", "windows-1252"])
def test_a_file_is_read_in_the_encoding_that_it_declares(tmp_path: Path, encoding: str) -> None:
    """Its text can be published as it is, and is the same robot."""
    text = f"\n<?xml version='1.0' encoding='{encoding}'?><robot name='é'><link name='ä'/></robot>"
    (tmp_path / "robot.urdf").write_bytes(text.lstrip().encode(encoding))
    found = Robot.from_urdf(tmp_path / "robot.urdf")
    assert (found.name, found.root) == ("é", "ä")
    assert Robot.from_text(found.text).root == "ä"
    assert Robot.from_text(text).root == "ä"


def spoilt(text: str, seed: int) -> bytes:
    """The text with a few bytes, or a part, changed, left out, repeated or moved."""
    chance = random.Random(seed)
    data = bytearray(text.encode())
    for _ in range(chance.randint(1, 6)):
        at, length = chance.randrange(len(data)), chance.choice((1, 1, 1, 8, 60))
        part = data[at : at + length]
        match chance.randrange(5):
            case 0:
                data[at : at + length] = chance.randbytes(length)
            case 1:
                data[at : at + length] = b""
            case 2:
                data[at:at] = part * chance.randint(1, 20)
            case 3:
                to = chance.randrange(len(data))
                data[to:to] = part
            case _:
                words = (b"nan", b"1e999", b"-0", b"'", b"<", b"&#0;", b"\xf0\x9f", b"<robot>")
                data[at:at] = chance.choice(words)
        data = data or bytearray(b"<")
    return bytes(data)


# Values of attributes, and elements without others in them.
PARTS = {"value": re.compile(r'"[^"]*"'), "element": re.compile(r"<[^<>]*/>")}
VALUES = ['"nan"', '"1e308 -1e308 1e308"', '"1e-320 0 0"', '"0 0 0"', '"-1"', '""', '"floating"']


def mixed(text: str, seed: int) -> bytes:
    """The text with a few values, or elements, left out or replaced by others of it."""
    chance = random.Random(seed)
    for _ in range(chance.randint(1, 4)):
        kind = chance.choice(list(PARTS))
        found = list(PARTS[kind].finditer(text))
        others = [each[0] for each in found] + (VALUES if kind == "value" else [""])
        at = chance.choice(found)
        text = text[: at.start()] + chance.choice(others) + text[at.end() :]
    return text.encode()


@pytest.mark.parametrize("spoil", [spoilt, mixed])
@given(st.integers(0, 2**32), st.sampled_from([ARM, HOVERCRAFT]))
@settings(max_examples=examples(300), deadline=None)
def test_a_spoilt_urdf_is_a_robot_or_a_sentence(
    spoil: Callable[[str, int], bytes],
    tmp_path_factory: pytest.TempPathFactory,
    seed: int,
    text: str,
) -> None:
    """Never another error; and a robot can be asked for its frames."""
    path = tmp_path_factory.getbasetemp() / "spoilt.urdf"
    path.write_bytes(spoil(text, seed))
    try:
        found = Robot.from_urdf(path)
    except UrdfError as error:
        assert str(error).isprintable() and len(str(error)) < 1000
        return
    try:
        assert found.fk().keys() == found.links.keys()
        found.joint_transforms(found.zeros())
    except InvalidArgumentException as error:
        assert "not finite" in str(error)
