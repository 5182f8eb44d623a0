"""The address at which a server for browsers listens, on a command line."""

from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from tfbus import NodeSettings
from tfbus.command.server import ServerOptions, server_options


def given(*arguments: str) -> tuple[int, str, list[ServerOptions]]:
    """The exit code, what is printed, and what the command gets."""
    got: list[ServerOptions] = []

    @click.command()
    @server_options("view", 8080)
    def command(listening: ServerOptions) -> None:
        got.append(listening)

    done = CliRunner().invoke(command, arguments)
    return done.exit_code, done.output, got


def test_it_listens_on_this_machine_unless_it_is_public() -> None:
    """With --public on all addresses, or on the one that is given."""
    assert given()[2][0].host == "127.0.0.1"
    assert given("--public")[2][0].host == "0.0.0.0"
    assert given("--public", "--host", "192.0.2.7")[2][0].host == "192.0.2.7"
    assert given("--host", "::1")[2][0].host == "::1"


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.0.2.7", "robot.lan"])
def test_an_address_that_others_reach_needs_public(host: str) -> None:
    """The error names it, and the tunnel that is safer."""
    code, text, _ = given("--host", host, "--port", "9000")
    assert code == 2
    assert "add --public" in text and "ssh -L 9000:127.0.0.1:9000" in text


def test_what_is_for_a_public_one_is_for_no_other(tmp_path: Path) -> None:
    """A token that nothing asks for would be a mistake that does not show."""
    path = tmp_path / "token"
    path.write_text("correct horse")
    for option in ("--token-file", "--certificate"):
        code, text, _ = given(option, str(path))
        assert code == 2 and f"{option} is for --public" in text
    code, text, _ = given("--public", "--key", str(path))
    assert code == 2 and "--key is the private" in text and "--certificate" in text


@pytest.mark.real
def test_the_token_is_new_or_of_the_environment_or_a_file(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Never of the command line, which everyone on the machine can read."""
    pytest.importorskip("cryptography", reason="needs cryptography: the extra secure")
    settings = NodeSettings("view")
    listening = given("--public")[2][0]
    public = listening.public(settings)
    assert public is not None and public.token.is_new
    monkeypatch.setenv("TFBUS_VIEW_TOKEN", "of the environment")
    public = listening.public(settings)
    assert public is not None and public.token.text == "of the environment"
    assert public.notes[-1].endswith("TFBUS_VIEW_TOKEN")
    path = tmp_path / "token"
    path.touch(0o600)
    path.write_text("of the file!")
    public = given("--public", "--token-file", str(path))[2][0].public(settings)
    assert public is not None and public.token.text == "of the file!"
