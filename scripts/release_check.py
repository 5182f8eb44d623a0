"""Check what a release would publish: `make release-check`.

    python scripts/release_check.py [FOLDER]       # keeps the sdist and a wheel of it there
    python scripts/release_check.py --wheel FILE   # only whether it runs on old systems
    python scripts/release_check.py --tag v1.2.3   # only whether it is the version, and dated

Builds the sdist, a wheel of the clone and one of the sdist, and compares their files; looks whether
the wheel runs on systems of manylinux_2_17 (`exp`, `log` or `pow` in a compiled module would raise
that to 2.29); and runs tests/installed.py with both on every Python
from 3.11 on that is there: the wheel without a compiler, the sdist with one and without.
"""

import os
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
import time
import tomllib
from pathlib import Path
from zipfile import ZipFile

HERE = Path(__file__).parents[1]
POLICY = "manylinux_2_17_"
# Of Python; more are looked for as pyenv lays them out.
MINORS = range(11, 20)
NEEDED = tomllib.loads((HERE / "pyproject.toml").read_text())["project"]["dependencies"]
# In the table of docs/reference/compatibility.md.
OTHER_ZENOHS = ("1.6.2", "1.9.0")
COMPILER = re.compile(r"^ccache$|gcc|g\+\+|clang|^(.*-)?(cc|c\+\+|c89|c99|tcc|cpp)(-[0-9.]+)?$")


def main() -> None:
    """Stop at the first that does not hold."""
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    sys.stdout.reconfigure(line_buffering=True)  # never replaced here
    match sys.argv[1:]:
        case ["--tag", tag]:
            check_tag(tag)
        case ["--wheel", wheel]:
            with tempfile.TemporaryDirectory() as folder:
                tools = environment(Path(folder), sys.executable, "auditwheel")
                check_policy(tools, Path(wheel))
        case [] | [_]:
            check_all()
        case _:
            sys.exit(__doc__)


def check_all() -> None:
    """What takes some minutes."""
    with tempfile.TemporaryDirectory(prefix="tfbus-release-") as folder:
        work = Path(folder)
        dist = Path(sys.argv[1]).absolute() if len(sys.argv) > 1 else work / "dist"
        tools = environment(work / "tools", sys.executable, "build", "auditwheel")
        # A clone has no leftovers of earlier builds.
        clone = work / "clone"
        run("git", "clone", "--quiet", HERE, clone)
        run(tools, "-m", "build", "--outdir", dist, clone)
        (sdist,) = dist.glob("*.tar.gz")
        (wheel,) = dist.glob("*.whl")
        check_sdist(clone, sdist)
        # Compiled modules come all or none: without them this takes no time.
        run(tools, "-m", "build", "--wheel", "--outdir", work / "from_clone", clone,
            TFBUS_PURE_PYTHON="1")  # fmt: skip
        (other,) = (work / "from_clone").glob("*.whl")
        ours = files_in(wheel)
        compiled = {name for name in ours if name.endswith((".so", ".pyd"))}
        same(ours - compiled, files_in(other), "the wheel of the sdist", "that of the clone")
        if not compiled:
            sys.exit(f"{wheel.name} has no compiled modules: is there a compiler?")
        check_policy(tools, wheel)
        bare = without_compiler(work / "bin")
        for python in pythons():
            check_installed(work, python, sdist, wheel, bare)
        check_other_zenohs(work)
    print("All of it holds.")


def check_tag(tag: str) -> None:
    """It is the version, of which the changelog has a section with a date."""
    version = tomllib.loads((HERE / "pyproject.toml").read_text())["project"]["version"]
    if tag != f"v{version}":
        sys.exit(f"The tag {tag} is not v{version}, the version in pyproject.toml")
    heading = rf"^## \[{re.escape(version)}\] - \d{{4}}-\d{{2}}-\d{{2}}$"
    if not re.search(heading, (HERE / "CHANGELOG.md").read_text(), re.MULTILINE):
        sys.exit(f"CHANGELOG.md has no section '## [{version}] - YYYY-MM-DD' with a date")
    if not (HERE / "tests" / "wire" / "frozen" / f"{version}.json").exists():
        sys.exit(f"tests/wire/frozen has no {version}.json: python -m tests.wire.frozen_wire")


def check_sdist(clone: Path, sdist: Path) -> None:
    """It has what is in git, but for hidden files."""
    listed = run("git", "-C", clone, "ls-files").splitlines()
    in_git = {name for name in listed if not name.startswith(".")}
    with tarfile.open(sdist) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    missing = sorted(in_git - names)
    if missing:
        sys.exit(f"{sdist.name} lacks {', '.join(missing)}")
    print(f"{sdist.name}: {len(in_git)} files, all that is in git")


def check_policy(tools: Path, wheel: Path) -> None:
    """Its modules need no newer C library than systems of the policy have."""
    if sys.platform != "linux":
        return
    said = " ".join(run(tools, "-m", "auditwheel", "show", wheel).split())
    if f'"{POLICY}' not in said:
        sys.exit(f"{wheel.name} is not {POLICY}*: {said}")
    print(f"{wheel.name}: {POLICY}*")


def check_installed(work: Path, python: str, sdist: Path, wheel: Path, bare: str) -> None:
    """The tests of what is installed: a wheel of this Python, and the sdist without a compiler."""
    version = run(python, "-c", "import sys; print('%d.%d' % sys.version_info[:2])").strip()
    if f"-cp{version.replace('.', '')}-" not in wheel.name:
        wheels = work / f"wheels{version}"
        builder = environment(work / f"builder{version}", python)
        run(builder, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", wheels, sdist)
        (wheel,) = wheels.glob("tfbus-*.whl")
    for what, source, is_compiled in (
        ("the wheel", wheel, True),
        ("the sdist without a compiler", sdist, False),
    ):
        began_s = time.monotonic()
        there = environment(work / f"{version}-{source.suffix[1:]}", python, "pytest", *NEEDED)
        installed_s = time.monotonic()
        run(there, "-m", "pip", "install", "--quiet", "--no-cache-dir", source, PATH=bare)
        taken_s = time.monotonic() - installed_s
        said = run(there, "-m", "tfbus", "--version", cwd=work)
        if ("runs without its compiled kernel" in said) == is_compiled:
            sys.exit(f"Python {version}, {what}: tfbus --version says {said}")
        shutil.copy(HERE / "tests" / "installed.py", work)
        run(there, "-m", "pytest", "-q", "-p", "no:cacheprovider", "installed.py", cwd=work)
        print(
            f"Python {version}: {what} installs in {taken_s:.1f} s beside what it needs, and "
            f"passes its tests ({time.monotonic() - began_s:.0f} s in all)",
            flush=True,
        )


def check_other_zenohs(work: Path) -> None:
    """Older releases of Zenoh and this one talk to each other; needs `make test`'s environment."""
    tests = HERE / ".venv" / "bin" / "python"
    if not tests.exists():
        print("Older releases of Zenoh: not tested, there is no .venv (make test)")
        return
    others = [
        environment(
            work / f"zenoh-{version}", sys.executable, f"eclipse-zenoh=={version}", "msgpack"
        )
        for version in OTHER_ZENOHS
    ]
    file = "tests/processes/test_other_releases.py"
    joined = os.pathsep.join(map(str, others))
    run(tests, "-m", "pytest", "-q", file, cwd=HERE, TFBUS_OTHER_ZENOH=joined)
    print(f"Zenoh {' and '.join(OTHER_ZENOHS)}: peers of theirs and ours understand each other")


def environment(folder: Path, python: str, *packages: str) -> Path:
    """The Python of a new environment with these packages."""
    run(python, "-m", "venv", folder)
    there = folder / "bin" / "python"
    if packages:
        run(there, "-m", "pip", "install", "--quiet", *packages)
    return there


def pythons() -> list[str]:
    """Every Python from 3.11 on, one of each minor version."""
    found = {}
    for minor in MINORS:
        near = sorted(Path.home().glob(f".pyenv/versions/3.{minor}.*/bin/python3"))
        for candidate in (*near, f"python3.{minor}"):
            probe = [
                str(candidate),
                "-c",
                f"import sys, venv; assert sys.version_info[1] == {minor}",
            ]
            try:
                subprocess.run(probe, check=True, capture_output=True)
            except (OSError, subprocess.CalledProcessError):
                continue
            found[minor] = str(candidate)
            break
    return list(found.values())


def without_compiler(folder: Path) -> str:
    """A PATH of all programs but compilers."""
    folder.mkdir()
    for place in os.environ["PATH"].split(os.pathsep):
        for program in Path(place).glob("*"):
            link = folder / program.name
            if not COMPILER.search(program.name) and not link.is_symlink():
                link.symlink_to(program)
    return str(folder)


def files_in(wheel: Path) -> set[str]:
    """The names of its files; dist-info is of the wheel itself."""
    with ZipFile(wheel) as archive:
        return {name for name in archive.namelist() if ".dist-info/" not in name}


def same(ours: set[str], theirs: set[str], our_name: str, their_name: str) -> None:
    """End where they differ."""
    if ours != theirs:
        sys.exit(
            f"Only in {our_name}: {sorted(ours - theirs)}; only in {their_name}: "
            f"{sorted(theirs - ours)}"
        )
    print(f"{our_name} and {their_name} have the same {len(ours)} files")


def run(*command: object, cwd: Path | None = None, **environment: str) -> str:
    """What it prints; ends this program where it fails."""
    words = [str(word) for word in command]
    done = subprocess.run(
        words, cwd=cwd, env=os.environ | environment, capture_output=True, text=True
    )
    if done.returncode:
        sys.exit(f"{done.stdout}{done.stderr}\nError: this failed: {' '.join(words)}")
    return done.stdout


if __name__ == "__main__":
    main()
