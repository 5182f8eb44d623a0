"""The build: every extension, or none; and sources that are not installed."""

import importlib.util
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tfbus.base.installation import why_not_installed

pytestmark = pytest.mark.real

HERE = Path(__file__).parents[1]

GOOD = """
#include <Python.h>
static struct PyModuleDef module = {PyModuleDef_HEAD_INIT, "good"};
PyMODINIT_FUNC PyInit_good(void) { return PyModule_Create(&module); }
"""
# In the place of Cython: two extensions, of which one cannot be compiled.
CYTHON = """
from setuptools import Extension

def cythonize(*_, **__):
    return [Extension("tfbus.good", ["good.c"]), Extension("tfbus.bad", ["bad.c"])]
"""


def test_one_extension_that_fails_leaves_all_out(tmp_path: Path):
    """A part of them would not work; the installation goes on without, and says so."""
    files = {
        "setup.py": (HERE / "setup.py").read_text(),
        "tfbus/__init__.py": "",
        "good.c": GOOD,
        "bad.c": "this is not C",
        "Cython/__init__.py": "",
        "Cython/Build.py": CYTHON,
    }
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    done = subprocess.run(
        [sys.executable, "setup.py", "build_ext", "--inplace"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    assert "without its compiled kernel" in done.stdout + done.stderr
    assert [*tmp_path.rglob("*.so"), *tmp_path.rglob("*.pyd")] == []
    assert "failed" in (tmp_path / "tfbus" / "not_compiled.txt").read_text()


def test_a_failed_compiler_is_said_at_the_import(tmp_path: Path):
    """pip hides what a build says, so that `import tfbus` has to: why, and the way out."""
    shutil.copytree(
        HERE / "tfbus", tmp_path / "tfbus", ignore=shutil.ignore_patterns("*.so", "*.pyd", "__py*")
    )
    shutil.copytree(HERE / "nodes", tmp_path / "tfbus" / "nodes")
    (tmp_path / "tfbus" / "not_compiled.txt").write_text("command 'gcc' failed")
    done = subprocess.run(
        [sys.executable, "-c", "import tfbus; tfbus.Buffer(); tfbus.Buffer()"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr.count("InterpretedWarning: ") == 1
    assert "command 'gcc' failed" in done.stderr


def test_the_tfbus_under_test_is_installed():
    """Its nodes are where they are imported from."""
    assert why_not_installed() == ""


def test_sources_that_are_not_installed_say_so(monkeypatch: pytest.MonkeyPatch):
    """The sentence names their folder, and both ways out."""
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    mistake = why_not_installed()
    assert str(HERE) in mistake
    assert "another folder" in mistake and "--editable" in mistake


def test_python_started_in_a_clone_says_so(tmp_path: Path):
    """The command ends with one sentence and no traceback; the import of a Buffer warns."""
    (tmp_path / "tfbus").symlink_to(HERE / "tfbus")
    # `-S` and the path of the libraries: without the finder of an installation in place.
    libraries = str(Path(pytest.__file__).parents[1])
    begin = f"import sys; sys.path[:0] = [{str(tmp_path)!r}]; sys.path.append({libraries!r}); "
    done = subprocess.run(
        [sys.executable, "-S", "-c", begin + "from tfbus.__main__ import main; main()"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 1
    assert done.stderr.startswith("Error: Python ") and "tfbus from the sources" in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_the_kernel_compiles_without_a_warning() -> None:
    """Neither Cython nor the C compiler had anything to say, when `make` last compiled it."""
    log = HERE / "build" / "kernel.log"
    if not log.exists():
        pytest.skip("needs the log of a compilation: make test")
    assert [line for line in log.read_text().splitlines() if "warning:" in line] == []
