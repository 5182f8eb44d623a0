"""The clone of the sources that tfbus runs from, if it does: its commit."""

import os
import subprocess
from contextlib import suppress
from pathlib import Path

_SHOWN = 7
_GIT_WITHIN_S = 5.0


def commit_of_clone(clone: Path = Path(__file__).parents[2]) -> str:
    """As in "clone at 1a2b3c4, changed"; "" if tfbus is installed, and not run from a clone.

    "changed" is said where git is there to ask; the commit is read from files if it is not.
    """
    if not (clone / ".git").exists() or not (clone / "pyproject.toml").exists():
        return ""
    commit, is_changed = _asked(clone) or (_read(clone), False)
    at = f" at {commit[:_SHOWN]}" if commit.isalnum() else ""
    return f"clone{at}{', changed' if is_changed else ''}"


def _asked(clone: Path) -> tuple[str, bool] | None:
    """The commit, and whether a file in git differs from it; None if git does not say."""
    # In a hook of git these name the repository of the hook.
    environment = {name: value for name, value in os.environ.items() if name[:4] != "GIT_"}
    command = ["git", "--no-optional-locks", "status", "--porcelain=v2", "--branch", "-uno"]
    try:
        done = subprocess.run(
            command,
            cwd=clone,
            env=environment,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=_GIT_WITHIN_S,
            text=True,
            errors="replace",
            check=True,
        )
    except (OSError, subprocess.SubprocessError):
        return None
    lines = done.stdout.splitlines()
    commits = [line.split()[2] for line in lines if line.startswith("# branch.oid ")]
    is_changed = any(not line.startswith("#") for line in lines)
    return ("" if commits == ["(initial)"] else "".join(commits)), is_changed


def _read(clone: Path) -> str:
    """The commit of HEAD, from git's files; "" if it cannot be found."""
    with suppress(OSError, UnicodeDecodeError, ValueError):
        folder = clone / ".git"
        if folder.is_file():  # a worktree
            folder = clone / _after("gitdir: ", folder.read_text())
        head = (folder / "HEAD").read_text().strip()
        if not head.startswith("ref: "):
            return head
        branch = _after("ref: ", head)
        common = folder / "commondir"
        shared = folder / common.read_text().strip() if common.exists() else folder
        if (shared / branch).exists():
            return (shared / branch).read_text().strip()
        for line in (shared / "packed-refs").read_text().splitlines():
            if line.endswith(f" {branch}"):
                return line.split()[0]
    return ""


def _after(begin: str, text: str) -> str:
    if not text.startswith(begin):
        raise ValueError(text)
    return text[len(begin) :].strip()
