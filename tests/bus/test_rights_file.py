"""The file of rights: written for people, read with its lines."""

from pathlib import Path

import pytest

from tfbus import TfbusError
from tfbus.bus.identity_folder import read_rights, write_rights
from tfbus.bus.rights import Identity, Rights


def test_what_is_written_is_read_again(tmp_path: Path) -> None:
    """All that an identity says of its rights is in the file."""
    identities = (
        Identity("arm", "publisher", "robot7", frames=("arm/*", "tool"), calls=()),
        Identity("ben", "operator", sets=("sim/*",), hosts=("ben.local", "10.0.0.7")),
        Identity("old", "reader", revoked="2026-11-22"),
    )
    rights = Rights({identity.name: identity for identity in identities})
    write_rights(tmp_path / "rights.yaml", rights)
    assert read_rights(tmp_path / "rights.yaml") == rights


@pytest.mark.parametrize(
    ("text", "mistake"),
    [
        ("", "rights.yaml:1: is empty"),
        ("identity: {}", "rights.yaml:1: identity: unknown key 'identity'; did you mean 'ident"),
        ("identities:\n  arm: {}", "rights.yaml:2: identities.arm: has no role"),
        ("identities:\n  arm: {role: boss}", "rights.yaml:2: identities.arm: 'boss' is no role"),
        (
            "identities:\n  arm:\n    role: reader\n    topic: [a]",
            "rights.yaml:4: identities.arm.topic: unknown key 'topic'; did you mean 'topics'",
        ),
        (
            "identities:\n  arm:\n    role: reader\n    topics: a",
            "rights.yaml:4: identities.arm.topics: must be a list",
        ),
        (
            "identities:\n  arm: {role: reader, frames: ['a b']}",
            "'a b' is not a pattern of names",
        ),
        ("identities:\n  a b: {role: reader}", "'a b' cannot be a node's name"),
    ],
)
def test_a_mistake_has_its_line(tmp_path: Path, text: str, mistake: str) -> None:
    """A mistake in the file is named with its line and what is allowed."""
    file = tmp_path / "rights.yaml"
    file.write_text(text)
    with pytest.raises(TfbusError) as caught:
        read_rights(file)
    assert mistake in str(caught.value)


def test_the_example_of_the_guide_is_valid(tmp_path: Path) -> None:
    """The rights that the guide shows can be read, and mean what it says beside them."""
    guide = Path(__file__).parents[2] / "docs" / "guide" / "security.md"
    (tmp_path / "rights.yaml").write_text(
        guide.read_text().partition("```yaml\n")[2].partition("```")[0]
    )
    rights = read_rights(tmp_path / "rights.yaml")
    arm, sim = rights.identity("arm"), rights.identity("sim")
    assert arm.allows("nodes", "gripper") and arm.allows("nodes", "arm_camera")
    assert arm.allows("frames", "tool") and not arm.allows("frames", "base_link")
    assert not arm.allows("calls", "spawn")
    assert sim.allows("nodes", "robot7/any") and sim.allows("topics", "clock")
    assert rights.identity("ben").allows("sets", "sim/background_r")
