"""Releases understand each other: each one's bytes are read, and no field is missing."""

from pathlib import Path

import pytest

from tests.builders import rows_of
from tests.wire.frozen_wire import FOLDER, frozen_now, lacks, message_types, read, values_of
from tfbus.base.installation import installed_version
from tfbus.wire.codec import decode_message, encode_message
from tfbus.wire.descriptions import (
    NodeDescription,
    ParameterDescription,
    StreamDescription,
    read_description,
)
from tfbus.wire.numbered import numbers_of
from tfbus.wire.transforms import decode_transforms, encode_transforms

RELEASES = sorted(FOLDER.glob("*.json"))
DESCRIPTIONS = (NodeDescription, ParameterDescription, StreamDescription)

every_release = pytest.mark.parametrize("release", RELEASES, ids=lambda path: path.stem)


def test_this_version_is_frozen() -> None:
    """What is written since the last release has a version of its own; docs/internals/releasing.md
    says how to freeze it.
    """
    assert read(FOLDER / f"{installed_version()}.json") == frozen_now()


@every_release
def test_keys_stay(release: Path) -> None:
    """What a release looks for is where it looks."""
    assert lacks(frozen_now()["keys"], read(release)["keys"]) == ""


@every_release
def test_transforms_of_a_release_are_read_and_written_alike(release: Path) -> None:
    """To the last bit, and with the fields that the release needs."""
    for payload in read(release)["transforms"].values():
        message = decode_transforms(bytes.fromhex(payload))
        again = encode_transforms(message)
        assert rows_of(decode_transforms(again).batch) == rows_of(message.batch)
        sent = values_of(payload)
        assert lacks(values_of(again.hex()), {k: v for k, v in sent.items() if k != "seq"}) == ""


@every_release
def test_messages_with_numbers_of_a_release_are_read(release: Path) -> None:
    """With its description, within the precision that it says; those of before have none."""
    frozen = read(release).get("numbered", {})
    for poses in frozen.keys() - {"description"}:
        described, _ = read_description(bytes.fromhex(frozen["description"]))
        message = decode_transforms(bytes.fromhex(frozen[poses]), numbers_of(described))
        rows = rows_of(message.batch)
        assert [row[:2] for row in rows] == [("base", "mast"), ("mast", "arm"), ("map", "base")]
        assert rows[0][3] == (0, 0, 1.5, 0, 0, 0, 1)
        assert rows[1][3] == pytest.approx((0.5, 0, 0, 0, 0, 0.6, 0.8), abs=1e-4)
        assert rows[2][3] == pytest.approx((5e5 + 8, 4e6 - 6, 2.001, 0, 0, 0.6, 0.8), abs=1e-4)


@every_release
def test_descriptions_of_a_release_are_read_and_written_alike(release: Path) -> None:
    """Each field keeps its name and meaning; others may have come."""
    kinds = {kind.__name__: kind for kind in DESCRIPTIONS}
    for name, payload in read(release)["descriptions"].items():
        described = decode_message(kinds[name], bytes.fromhex(payload))
        assert lacks(values_of(encode_message(described).hex()), values_of(payload)) == "", name
    stream = bytes.fromhex(read(release)["descriptions"]["StreamDescription"])
    assert read_description(stream)[1] == ""


@every_release
def test_messages_of_a_release_are_read_and_written_alike(release: Path) -> None:
    """Topics, services and actions of two releases go together."""
    kinds = {kind.__qualname__: kind for kind in message_types()}
    for name, payload in read(release)["messages"].items():
        message = decode_message(kinds[name], bytes.fromhex(payload))
        assert lacks(values_of(encode_message(message).hex()), values_of(payload)) == "", name
