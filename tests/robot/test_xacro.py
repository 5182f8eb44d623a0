"""xacro files: expanded with arguments, their packages and includes found."""

import sys
from pathlib import Path

import pytest

from tests import needs
from tfbus import Robot, UrdfError

pytestmark = pytest.mark.real

needs.module("xacro")

ARM = """<?xml version="1.0"?>
<robot name="arm" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:arg name="length" default="1"/>
  <xacro:arg name="gripper" default="false"/>
  <xacro:include filename="$(find parts)/wrist.xacro"/>
  <link name="base"/>
  <link name="tip"/>
  <joint name="bone" type="fixed">
    <parent link="base"/> <child link="tip"/> <origin xyz="${2 * $(arg length)} 0 0"/>
  </joint>
  <xacro:if value="$(arg gripper)"><xacro:wrist parent="tip"/></xacro:if>
</robot>
"""

WRIST = """<robot xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:macro name="wrist" params="parent">
    <link name="wrist"/>
    <joint name="turn" type="continuous">
      <parent link="${parent}"/> <child link="wrist"/> <axis xyz="0 0 1"/>
    </joint>
  </xacro:macro>
</robot>
"""


@pytest.fixture
def arm(tmp_path: Path) -> Path:
    """A xacro file beside the package that it includes a file of."""
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "package.xml").touch()
    (tmp_path / "parts" / "wrist.xacro").write_text(WRIST)
    (tmp_path / "arm").mkdir()
    (tmp_path / "arm" / "package.xml").write_text("<package><name>arm_description</name></package>")
    path = tmp_path / "arm" / "arm.urdf.xacro"
    path.write_text(ARM)
    return path


def test_a_xacro_file_is_expanded_with_arguments(arm: Path) -> None:
    """Numbers and truths of Python among them; what it includes is known."""
    assert Robot.from_urdf(arm).fk()["tip"].x == 2.0
    robot = Robot.from_urdf(arm, xacro_args={"length": 3, "gripper": True})
    assert robot.fk()["tip"].x == 6.0
    assert [joint.name for joint in robot.free_joints] == ["turn"]
    assert robot.files == (arm, arm.parents[1] / "parts" / "wrist.xacro")
    assert Robot.from_text(robot.text).fk() == robot.fk()


def test_packages_are_found_in_the_package_path(arm: Path, tmp_path: Path) -> None:
    """Before those above the file; one that is nowhere is named."""
    other = tmp_path / "other" / "parts"
    other.mkdir(parents=True)
    (other / "wrist.xacro").write_text(WRIST.replace('"turn"', '"other"'))
    robot = Robot.from_urdf(arm, package_path=other.parent, xacro_args={"gripper": True})
    assert [joint.name for joint in robot.free_joints] == ["other"]
    arm.write_text(ARM.replace("find parts", "find prats"))
    with pytest.raises(UrdfError, match=r"package 'prats' .*--package-path"):
        Robot.from_urdf(arm)


@pytest.mark.parametrize(
    ("before", "after", "said"),
    [
        ("2 * $(arg length)", "1 / 0", "xacro cannot expand it: division by zero"),
        (
            "$(arg length)",
            "$(arg width)",
            "xacro cannot expand it: Undefined substitution argument",
        ),
        ('value="$(arg gripper)"', 'value="maybe"', "xacro cannot expand it: Xacro conditional"),
        ("</robot>", "", ":13: not XML: no element found"),
        ('<link name="tip"/>', "", "(expanded):"),
        ('<?xml version="1.0"?>', '<!DOCTYPE r [<!ENTITY a "b">]>', ":1: its DOCTYPE has"),
        ('"$(find parts)/wrist.xacro"', '"none.xacro"', "none.xacro"),
    ],
)
def test_what_xacro_cannot_expand_is_one_sentence(
    arm: Path, before: str, after: str, said: str, capfd: pytest.CaptureFixture[str]
) -> None:
    """With the file; nothing else is printed."""
    arm.write_text(ARM.replace(before, after))
    with pytest.raises(UrdfError) as caught:
        Robot.from_urdf(arm)
    assert str(caught.value).startswith(str(arm)) and said in str(caught.value)
    assert "\n" not in str(caught.value) and capfd.readouterr() == ("", "")


def test_what_xacro_warns_of_is_a_warning_of_the_robot(
    arm: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """In one sentence with the file; it is not printed."""
    many = '<xacro:include filename="$(find parts)/none_*.xacro"/>'
    arm.write_text(ARM.replace('<link name="tip"/>', f'<link name="tip"/>{many}'))
    (said,) = Robot.from_urdf(arm).warnings
    assert said.startswith(f"{arm}: xacro: Include tag") and "\n" not in said
    assert capfd.readouterr() == ("", "")


def test_arguments_are_for_xacro_files(tmp_path: Path) -> None:
    """A URDF has none."""
    (tmp_path / "a.urdf").write_text("<robot name='a'><link name='a'/></robot>")
    with pytest.raises(UrdfError, match=r"a\.urdf takes no arguments"):
        Robot.from_urdf(tmp_path / "a.urdf", xacro_args={"a": 1})


def test_the_package_of_the_file_is_found_by_its_package_xml(arm: Path) -> None:
    """Though its folder has another name."""
    include = '"$(find arm_description)/../parts/wrist.xacro"'
    arm.write_text(ARM.replace('"$(find parts)/wrist.xacro"', include))
    assert Robot.from_urdf(arm, xacro_args={"gripper": True}).free_joints


@pytest.mark.parametrize(
    "expression",
    [
        "${9**9**9}",
        "${[0] * 10**10}",
        "".join(
            f'<xacro:macro name="m{n}" params="">{f"<xacro:m{n + 1}/>" * 10}</xacro:macro>'
            for n in range(8)
        )
        + '<xacro:macro name="m8" params=""><a/></xacro:macro><xacro:m0/>',
    ],
)
def test_what_would_never_end_is_a_mistake(
    arm: Path, expression: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After 30 s of CPU, here 1 s, or 2 GB: a power, a list, macros that call macros."""
    limited = "tfbus.robot.xacro_file"
    program = f"import {limited} as x; x.MOST_CPU_S = 1; x.main()"
    monkeypatch.setattr(
        "tfbus.robot.xacro_file.command_of", lambda module: [sys.executable, "-c", program]
    )
    arm.write_text(ARM.replace('<link name="tip"/>', f'<link name="tip"/>{expression}'))
    with pytest.raises(UrdfError, match=r"xacro (has|needs|cannot) "):
        Robot.from_urdf(arm)


@pytest.mark.parametrize(
    ("program", "said"),
    [
        ("import os; os.abort()", "crashed, by SIGABRT"),
        ("raise SystemExit(3)", "crashed, with exit code 3"),
    ],
)
def test_a_crash_is_called_one(
    arm: Path, program: str, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And not a limit of time."""
    monkeypatch.setattr(
        "tfbus.robot.xacro_file.command_of", lambda module: [sys.executable, "-c", program]
    )
    with pytest.raises(UrdfError, match=said):
        Robot.from_urdf(arm)
