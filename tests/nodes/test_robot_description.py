"""The file of a robot: when it is read again, and the arguments of xacro."""

import os
from pathlib import Path

import pytest

from tests.nodes.robots import ARM
from tfbus import UrdfError
from tfbus.nodes.robot.description import DescriptionFile, xacro_arguments

XACRO = """
<robot name="made" xmlns:xacro="http://ros.org/wiki/xacro">
  <xacro:arg name="n" default="1"/>
  <xacro:include filename="part.xacro"/>
  <link name="link_$(arg n)"/>
</robot>
"""
PART = '<robot xmlns:xacro="http://ros.org/wiki/xacro"><xacro:property name="a" value="1"/></robot>'


def write(path: Path, text: str, at_s: float) -> None:
    """Write a file that was changed at this time."""
    path.write_text(text)
    os.utime(path, (at_s, at_s))


def test_a_change_counts_once_it_has_settled(tmp_path: Path) -> None:
    """A file that has changed is read again when it was the same at two looks."""
    path = tmp_path / "arm.urdf"
    write(path, ARM, 100)
    file = DescriptionFile(path)
    file.load()
    assert not file.has_changed()
    write(path, ARM[:100], 101)
    assert not file.has_changed()
    write(path, ARM + " ", 102)
    assert not file.has_changed()
    assert file.has_changed()
    file.load()
    assert not file.has_changed()


def test_a_mistake_is_named_once(tmp_path: Path) -> None:
    """A file that cannot be read is not read again until it changes."""
    path = tmp_path / "arm.urdf"
    write(path, ARM[:100], 100)
    file = DescriptionFile(path)
    with pytest.raises(UrdfError):
        file.load()
    assert not file.has_changed() and not file.has_changed()


@pytest.mark.real
def test_an_included_file_counts_too(tmp_path: Path) -> None:
    """A change of a file that a xacro file includes is a change."""
    pytest.importorskip("xacro")
    path, part = tmp_path / "arm.xacro", tmp_path / "part.xacro"
    write(path, XACRO, 100)
    write(part, PART, 100)
    file = DescriptionFile(path, xacro_args={"n": "7"})
    assert list(file.load().links) == ["link_7"]
    assert not file.has_changed()
    write(part, PART, 101)
    assert not file.has_changed()
    assert file.has_changed()


def test_arguments_are_names_and_values() -> None:
    """`name:=value`, with anything as the value."""
    assert xacro_arguments(["a:=1", "b:=x:=y", "c:="]) == {"a": "1", "b": "x:=y", "c": ""}
    with pytest.raises(ValueError, match=r"'a=1' .*name:=value"):
        xacro_arguments(["a=1"])
