"""The version, and the commit of a clone, of which git tells."""

import subprocess
from pathlib import Path

import pytest

from tests.buses import DEADLINE_S
from tfbus.base.installation import commit_of_clone, version_and_origin

pytestmark = pytest.mark.real

HERE = Path(__file__).parents[2]


def git(folder: Path, *arguments: str) -> str:
    names = ["-c", "user.name=a", "-c", "user.email=a@b", "-c", "commit.gpgsign=false"]
    done = subprocess.run(
        ["git", *names, *arguments], cwd=folder, check=True, capture_output=True, text=True
    )
    return done.stdout.strip()


@pytest.fixture
def clone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A repository of one commit."""
    for name in ("GIT_DIR", "GIT_WORK_TREE", "GIT_INDEX_FILE"):
        monkeypatch.delenv(name, raising=False)
    # On a busy machine git itself takes longer than its users would wait.
    monkeypatch.setattr("tfbus.base.installation._GIT_WITHIN_S", DEADLINE_S)
    folder = tmp_path / "clone"
    folder.mkdir()
    (folder / "pyproject.toml").write_text("")
    git(folder, "init", "--quiet")
    git(folder, "add", "pyproject.toml")
    git(folder, "commit", "--quiet", "--message", "Begin")
    return folder


def test_a_clone_says_its_commit(clone: Path) -> None:
    """Seven digits of it."""
    assert commit_of_clone(str(clone)) == f"clone at {git(clone, 'rev-parse', 'HEAD')[:7]}"


def test_a_changed_clone_says_so(clone: Path) -> None:
    """A file that git does not have is no change: each build makes some."""
    (clone / "build.log").write_text("")
    assert not commit_of_clone(str(clone)).endswith("changed")
    (clone / "pyproject.toml").write_text("[project]")
    assert commit_of_clone(str(clone)).endswith(", changed")


def test_without_git_it_is_a_clone_alone(clone: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing else reads the repository."""
    monkeypatch.setenv("PATH", "")
    assert commit_of_clone(str(clone)) == "clone"


def test_a_broken_repository_is_no_error(clone: Path) -> None:
    """The version is said without a commit."""
    (clone / ".git" / "HEAD").write_text("\0")
    assert commit_of_clone(str(clone)) == "clone"


def test_an_installed_package_is_no_clone(tmp_path: Path) -> None:
    """Even where an environment lies in the repository of something else."""
    (tmp_path / ".git").mkdir()
    assert commit_of_clone(str(tmp_path)) == ""


def test_the_version_stands_in_one_place() -> None:
    """pyproject.toml says it; sources and scripts read it from there."""
    version = version_and_origin().split()[0]
    files = [HERE / "setup.py", *(HERE / "tfbus").rglob("*.py"), *(HERE / "nodes").rglob("*.py")]
    assert [path for path in files if f'"{version}"' in path.read_text(encoding="utf-8")] == []
