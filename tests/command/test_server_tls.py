"""The certificate of a page that others can reach."""

import socket
from pathlib import Path

import pytest

from tfbus.base.errors import SettingsError

pytest.importorskip("cryptography", reason="needs cryptography: pip install cryptography")

from tfbus.bus.keystore import Issued, make_for_server
from tfbus.command.server_access import made_tls, tls_of_files


@pytest.fixture
def made() -> Issued:
    """A certificate for robot.example and all names below lab.example."""
    return make_for_server(["Robot.example", "*.lab.example"], 1.0)


@pytest.mark.real
def test_a_made_certificate_is_for_the_names_of_this_machine() -> None:
    """By name, and at the address that it listens at; its fingerprint is said."""
    tls = made_tls("192.0.2.7")
    assert {"192.0.2.7", "localhost", socket.gethostname().lower()} <= tls.names
    assert "SHA-256 fingerprint, " in tls.note


def test_a_certificate_may_stand_with_its_key_or_apart(made: Issued, tmp_path: Path) -> None:
    """Its names are those that the page is opened under."""
    both, apart, key = (tmp_path / name for name in ("both.pem", "apart.pem", "key.pem"))
    both.write_bytes(made.certificate + made.key)
    apart.write_bytes(made.certificate)
    key.write_bytes(made.key)
    assert tls_of_files(both).names == tls_of_files(apart, key).names
    assert tls_of_files(both).names == {"robot.example", "*.lab.example"}
    with pytest.raises(SettingsError, match="its private key"):
        tls_of_files(apart)


def test_what_is_no_certificate_is_said(tmp_path: Path) -> None:
    """With the name of the file."""
    path = tmp_path / "text.pem"
    path.write_text("hello")
    with pytest.raises(SettingsError, match=r"text\.pem .*in PEM"):
        tls_of_files(path)


def test_an_expired_certificate_is_refused(tmp_path: Path) -> None:
    """No browser would take it."""
    made = make_for_server(["robot"], -0.001)
    path = tmp_path / "old.pem"
    path.write_bytes(made.certificate + made.key)
    with pytest.raises(SettingsError, match="expired on"):
        tls_of_files(path)
