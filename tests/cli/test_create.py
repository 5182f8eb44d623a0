"""`tfbus create`: its files, and the names that it refuses."""

from pathlib import Path

import pytest
from click.testing import CliRunner

from tfbus.cli.create import command


@pytest.mark.parametrize(
    ("package", "node"),
    [("my_robot", "my_node"), ("my_node_pkg", "driver"), ("my_node", "driver"), ("a", "my_robot")],
)
def test_the_files_bear_the_names_given(tmp_path: Path, package: str, node: str) -> None:
    """Package and node get their names, also if one looks like a name of the template."""
    done = CliRunner().invoke(command, [package, "--node", node, "--directory", str(tmp_path)])
    assert done.exit_code == 0
    folder = tmp_path / package
    assert f'{node} = "{package}.{node}:main"' in (folder / "pyproject.toml").read_text()
    assert f"from {package}.{node} import" in (folder / f"tests/test_{node}.py").read_text()
    assert f'Node.from_args("{node}", argv)' in (folder / package / f"{node}.py").read_text()


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["tfbus"], "'tfbus' is already the name of a Python package"),
        (["tests"], "'tests' is already the name of a Python package"),
        (["json"], "'json' is already the name of a Python package"),
        (["1st"], "'1st' cannot be a Python package"),
        (["mine", "--node", "echo"], "`tfbus echo` is already a command"),
        (["mine", "--node", "launch"], "`tfbus launch` is already a command"),
        (["mine", "--node", "class"], "'class' cannot be a Python package"),
        (["mine", "--node", "mine"], "need different names"),
    ],
)
def test_names_that_would_clash_are_refused(
    tmp_path: Path, arguments: list[str], reason: str
) -> None:
    """A name that another package or command has is a usage error, and nothing is written."""
    done = CliRunner().invoke(command, [*arguments, "--directory", str(tmp_path)])
    assert (done.exit_code, list(tmp_path.iterdir())) == (2, [])
    assert reason in " ".join(done.output.split())


def test_a_folder_that_cannot_be_written_is_an_error(tmp_path: Path) -> None:
    """It is one sentence, with exit code 1."""
    (tmp_path / "file").write_text("")
    done = CliRunner().invoke(command, ["mine", "--directory", str(tmp_path / "file")])
    assert done.exit_code == 1
    assert done.output.startswith(f"Error: {tmp_path}/file/mine ")
    assert done.output.endswith(": Not a directory\n") and done.output.count("\n") == 1


def test_a_reader_that_is_gone_loses_no_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The package stays where nobody reads the names of its files, as behind a pipe that ended."""

    def gone(*_: object) -> None:
        raise BrokenPipeError

    monkeypatch.setattr("tfbus.cli.create.click.echo", gone)
    with pytest.raises(BrokenPipeError):
        command.main(["mine", "--directory", str(tmp_path)], standalone_mode=False)
    assert (tmp_path / "mine" / "README.md").is_file()
