"""The buffer's tests and a fuzz of it, in a build with the sanitizers of addresses and of undefined
behaviour: any report is a failure. Takes about two minutes on two cores.

python tests/sanitized.py [--seconds 15]

If there is no compiler, or it has no sanitizers, it says so and succeeds.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterable
from pathlib import Path
from tempfile import TemporaryDirectory

ROOT = Path(__file__).resolve().parents[1]
FLAGS = "-O0 -g1 -fno-omit-frame-pointer -fsanitize=address,undefined -fno-sanitize-recover=all"
# A thread with a small stack, which the sanitizers' own needs would fill.
LEFT_OUT = ("test_limits.py",)


def find_compiler() -> tuple[str, str] | None:
    """A compiler, and its libasan; None where one of them is missing."""
    for name in ("gcc", "cc"):
        compiler = shutil.which(name)
        if compiler is None:
            continue
        asked = [compiler, "-print-file-name=libasan.so"]
        library = subprocess.run(asked, capture_output=True, text=True).stdout.strip()
        if Path(library).is_absolute() and Path(library).exists():
            return compiler, library
    return None


def build(folder: Path, compiler: str) -> None:
    """Copy the project into the folder, and compile it there."""
    for name in ("tfbus", "tests", "nodes", "configs"):
        shutil.copytree(
            ROOT / name, folder / name, ignore=shutil.ignore_patterns("*.so", "__pycache__")
        )
    for name in ("setup.py", "pyproject.toml", "README.md"):
        shutil.copy(ROOT / name, folder)
    # setup.py has options of its own for some modules: these come last, so they count.
    wrapper = folder / "cc"
    wrapper.write_text(f'#!/bin/sh\nexec "{compiler}" "$@" {FLAGS}\n')
    wrapper.chmod(0o755)
    # What pip builds with, which is not otherwise installed.
    tools = folder / "build_tools"
    requires = tomllib.loads((ROOT / "pyproject.toml").read_text())["build-system"]["requires"]
    run([sys.executable, "-m", "pip", "install", "-q", "--target", tools, *requires], folder)
    build_ext = [sys.executable, "setup.py", "-q", "build_ext", "--inplace"]
    run(build_ext, folder, CC=str(wrapper), PYTHONPATH=str(tools))


def run(command: Iterable[str | Path], folder: Path, **env: str) -> None:
    """Run a command in the folder; ends this program where it fails."""
    done = subprocess.run(list(command), cwd=folder, env={**os.environ, **env})
    if done.returncode:
        sys.exit(f"failed with {done.returncode}: {' '.join(map(str, command))}")


def main() -> None:
    """Build, test, fuzz."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--seconds", type=float, default=15.0)
    seconds = parser.parse_args().seconds
    found = find_compiler()
    if found is None:
        print("skipped: needs a C compiler with libasan (apt-get install gcc)")
        return
    compiler, library = found
    with TemporaryDirectory(prefix="tfbus-sanitized-") as name:
        folder = Path(name)
        build(folder, compiler)
        watched = {
            "LD_PRELOAD": library,
            # Python itself keeps memory to its end.
            "ASAN_OPTIONS": "detect_leaks=0",
            "UBSAN_OPTIONS": "print_stacktrace=1",
            # Each object is an allocation of its own, so that one that is freed is noticed.
            "PYTHONMALLOC": "malloc",
            "PYTHONPATH": str(folder),
        }
        tests = sorted(
            path
            for path in (folder / "tests/buffer").glob("test_*.py")
            if path.name not in LEFT_OUT
        )
        fuzz = [sys.executable, "tests/buffer/fuzz_buffer.py", "--seconds", str(seconds)]
        run(fuzz, folder, **watched)
        pytest = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider"]
        run([*pytest, "--stress-s", "0.5", *tests], folder, **watched)


if __name__ == "__main__":
    main()
