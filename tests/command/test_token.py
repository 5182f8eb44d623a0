"""The token of a page that others can reach."""

from pathlib import Path

import pytest

from tfbus.base.errors import SettingsError
from tfbus.command.server_access import AccessToken, read_token


def test_a_token_is_new_unless_it_is_given() -> None:
    """A new one has 128 random bits; a given one at least 12 characters."""
    assert len(AccessToken().text) >= 22 and AccessToken().text != AccessToken().text
    assert AccessToken().is_new and not AccessToken("correct horse").is_new
    with pytest.raises(SettingsError, match=r"5 characters, .* 12"):
        AccessToken("horse")


def test_a_token_is_not_shown_where_it_is_printed() -> None:
    """As in a traceback, or a log of what holds it."""
    token = AccessToken()
    assert token.text not in repr(token)


def test_wrong_tokens_are_limited_by_address() -> None:
    """After 10 in a minute not even the right one is taken; other addresses are not disturbed."""
    token = AccessToken("correct horse")
    assert [token.judge(f"wrong {turn}", "10.0.0.7") for turn in range(10)] == ["wrong"] * 10
    assert token.judge("correct horse", "10.0.0.7") == "too often"
    assert token.judge("correct horse", "10.0.0.8") == "right"


def test_a_machine_has_half_of_an_address_of_ipv6() -> None:
    """It could guess from each of the others."""
    token = AccessToken("correct horse")
    for turn in range(10):
        token.judge("wrong", f"fd00::{turn}")
    assert token.judge("wrong", "fd00::ffff%eth0") == "too often"
    assert token.judge("wrong", "fd00:0:0:1::1") == "wrong"


def test_any_text_can_be_judged() -> None:
    """Also one that is no Unicode, from an address that is none."""
    assert AccessToken("correct horse").judge("\udcff", "") == "wrong"


def test_a_token_in_a_file_is_its_owners_alone(tmp_path: Path) -> None:
    """Others must not read it; it is the first line."""
    path = tmp_path / "token"
    path.write_text("correct horse\n# of the lab\n")
    path.chmod(0o644)
    with pytest.raises(SettingsError, match=f"others may read .*{path}: chmod"):
        read_token(path)
    path.chmod(0o600)
    assert read_token(path).text == "correct horse"
    path.write_text("\n")
    with pytest.raises(SettingsError, match="no token in"):
        read_token(path)
