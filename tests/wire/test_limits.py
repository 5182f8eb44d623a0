"""How large messages may be."""

import pytest

from tfbus import SettingsError
from tfbus.base.errors import DecodeError
from tfbus.wire.limits import Limits, check_size, kind_of, size_text


@pytest.mark.parametrize(
    ("key", "kind"),
    [
        ("tf/sim", "transforms"),
        ("tf/sim/a%2Fb", "transforms"),
        ("**/tf/**", "transforms"),
        ("robot7/tf_static/sim", "transforms"),
        ("tf/**?last_s=2.5", "transforms"),
        ("tf_static/*/@adv/pub/**", "transforms"),
        ("**/@tfbus/stream/*", "description"),
        ("@tfbus/node/sim", "description"),
        ("robot7/@tfbus/param/sim/rate", "parameter"),
        ("@tfbus/clock/sim", "clock"),
        ("turtle1/pose", "topic"),
        ("tf2/pose", "topic"),
        ("camera/tfx", "topic"),
    ],
)
def test_the_key_says_the_kind(key: str, kind: str) -> None:
    """The kind of a message is known before a byte of it is read."""
    assert kind_of(key) == kind


def test_a_payload_of_the_limit_is_read_and_a_larger_one_is_not() -> None:
    """The error names the size, the limit, and how to raise it."""
    limits = Limits(topic=1000)
    check_size("topic", bytes(1000), limits)
    with pytest.raises(DecodeError, match=r"1 kB; .*LIMITS=topic=2kB"):
        check_size("topic", bytes(1001), limits)


def test_limits_are_read_from_a_text() -> None:
    """What the text does not name keeps its default."""
    assert Limits.parse("topic=64MB, service = 500 kB") == Limits(topic=64_000_000, service=500_000)
    assert Limits.parse("") == Limits()


@pytest.mark.parametrize("text", ["topic", "topic=", "topic=-1", "images=5MB", "topic=5mb"])
def test_a_text_of_another_form_is_refused_with_the_right_one(text: str) -> None:
    """The error shows the form, the kinds and the units."""
    with pytest.raises(SettingsError, match="as in topic=64MB"):
        Limits.parse(text)


@pytest.mark.parametrize("size", [0, -1, 3_000_000_000, 1.5])
def test_a_limit_is_a_positive_number_of_bytes(size: int) -> None:
    """A limit that Zenoh cannot hold is refused."""
    with pytest.raises(SettingsError, match="limit of topic"):
        Limits(topic=size)


@pytest.mark.parametrize(
    ("size", "text"), [(12, "12 B"), (1500, "1.5 kB"), (32_000_000, "32 MB"), (10**9, "1 GB")]
)
def test_a_size_is_said_in_its_unit(size: int, text: str) -> None:
    """Three digits are enough."""
    assert size_text(size) == text
