"""Set up .venv, and compile the kernel: what `make demo` and `make test` need first.

    python scripts/environment.py packages EXTRA    tfbus in place, interpreted, and what it needs
    .venv/bin/python scripts/environment.py kernel  compile what has changed, and wait for it
    .venv/bin/python scripts/environment.py tests   write the bytecode of the tests
    .venv/bin/python scripts/environment.py run COMMAND...
                                                    compile while COMMAND runs, for the next

Each step is a line, and each 3 s that it takes one more. uv does what pip does where it is
installed, in less time.
"""

import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import tomllib
from pathlib import Path

HERE = Path(__file__).parents[1]
VENV = HERE / ".venv"
PYTHON = VENV / "bin" / "python"
COMPILE = [str(PYTHON), "setup.py", "--quiet", "build_ext", "--inplace"]
# What the compilers said, of which a test makes sure that it is no warning.
KERNEL_LOG = HERE / "build" / "kernel.log"

_A_LINE_EVERY_S = 3.0
_WIDTH = 60
_STARTED_S = time.monotonic()
_UV = shutil.which("uv")


def main() -> None:
    """Do what the command line says."""
    os.chdir(HERE)
    # Each process here would compile all that it imports.
    writes_bytecode = os.environ.pop("PYTHONDONTWRITEBYTECODE", "") == ""
    use_ccache()
    match sys.argv[1:]:
        case ["packages", extra]:
            make_environment()
            install(extra, compiled=extra == "dev" and not writes_bytecode)
        case ["kernel"]:
            compile_kernel()
        case ["tests"]:
            write_bytecode_of_tests()
        case ["run", *command]:
            sys.exit(run(command))
        case _:
            sys.exit(__doc__)


def use_ccache() -> None:
    """A kernel that was compiled once, also in another clone, is not compiled again."""
    links = Path("/usr/lib/ccache")
    has_compiler = shutil.which("gcc") or shutil.which("clang")
    if links.is_dir() and has_compiler and not os.environ.get("CC"):
        os.environ["PATH"] = f"{links}{os.pathsep}{os.environ['PATH']}"


def make_environment() -> None:
    """`.venv`, if it is not there; with pip, for those who look for it."""
    if PYTHON.exists():
        return
    if not _UV or not step(
        "Make an environment in .venv (uv)",
        [_UV, "venv", "--quiet", "--seed", "--python", sys.executable, str(VENV)],
        may_fail=True,
    ):
        step("Make an environment in .venv", [sys.executable, "-m", "venv", "--clear", str(VENV)])


def install(extra: str, *, compiled: bool) -> None:
    """The packages of an extra, what compiles the kernel, and tfbus itself, interpreted.

    Python writes the bytecode of what it imports. To write it for all modules at once is most of
    pip's time, and serves only those for whom Python writes none: then it is `compiled`.
    """
    project = tomllib.loads((HERE / "pyproject.toml").read_text())
    packages = [*project["build-system"]["requires"], *needed(project["project"], extra)]
    title = f"Install {len(packages)} packages, and those that they need"
    with_pip(title, ["--compile" if compiled else "--no-compile"], packages)
    # The kernel comes later, by `kernel` or `run`.
    os.environ["TFBUS_PURE_PYTHON"] = "1"
    with_pip("Install tfbus in place", ["--no-deps", "--no-build-isolation"], ["-e", "."])


def needed(project: dict[str, object], extra: str) -> list[str]:
    """What tfbus and the extra require; an extra may stand for others, as `tfbus[view,sim]`."""
    extras: dict[str, list[str]] = project["optional-dependencies"]
    found: dict[str, None] = dict.fromkeys(project["dependencies"])

    def add(name: str) -> None:
        for requirement in extras[name]:
            if requirement.startswith("tfbus["):
                for other in requirement[len("tfbus[") : -1].split(","):
                    add(other.strip())
            else:
                found[requirement] = None

    for name in extra.split(","):
        add(name)
    return list(found)


# What uv calls it; it compiles nothing by default.
_IN_UV = {"--compile": ["--compile-bytecode"], "--no-compile": []}


def with_pip(title: str, options: list[str], packages: list[str]) -> None:
    """By uv, or by pip where that is not there or fails: it may know other indexes."""
    if _UV:
        ours = [word for option in options for word in _IN_UV.get(option, [option])]
        uv = [_UV, "pip", "install", "--python", str(PYTHON)]
        if step(f"{title} (uv)", [*uv, *ours, *packages], may_fail=True):
            return
    pip = [str(PYTHON), "-m", "pip", "install", "--disable-pip-version-check"]
    step(title, [*pip, "--progress-bar=off", *options, *packages])


def compile_kernel() -> None:
    """In the place of what is interpreted: what has changed, or all of it the first time."""
    KERNEL_LOG.parent.mkdir(exist_ok=True)
    step("Compile the kernel", COMPILE, log=KERNEL_LOG)
    if not is_compiled():
        reason = HERE / "tfbus" / "not_compiled.txt"
        why = reason.read_text().strip() if reason.exists() else "see above"
        say(f"  failed, tfbus runs interpreted: {why}")


def is_compiled() -> bool:
    """Whether the kernel is there, be it of older sources."""
    return any((HERE / "tfbus").rglob("*.so"))


def write_bytecode_of_tests() -> None:
    """Once, before several processes would each write all of it."""
    collect = [str(PYTHON), "-m", "pytest", "--collect-only", "--quiet"]
    step("Write the bytecode of the tests", collect, may_fail=True)


def run(command: list[str]) -> int:
    """The command's exit code; the kernel is compiled meanwhile, if it is not there.

    It yields to the command, and is used from the next start on: compiled and interpreted modules
    do not go together. What is not compiled when the command ends, the next `make` compiles.
    """
    if is_compiled():
        compile_kernel()
        return wait_for(subprocess.Popen(command))
    build = [str(PYTHON), "setup.py", "--quiet", "build_ext"]
    say("The kernel is compiled while the demo runs, and used from the next start on")
    # In a session of its own: Ctrl-C is for the command.
    with tempfile.TemporaryFile() as out:
        behind = subprocess.Popen(
            ["nice", "-n", "19", *build], stdout=out, stderr=out, start_new_session=True
        )
        try:
            code = wait_for(subprocess.Popen(command))
        finally:
            is_done = behind.poll() == 0
            if behind.poll() is None:
                os.killpg(behind.pid, signal.SIGTERM)
                behind.wait()
    if is_done:
        compile_kernel()
    else:
        say("The kernel is not compiled yet: the next `make` goes on with it")
    return code


def wait_for(process: subprocess.Popen[bytes]) -> int:
    """Its exit code; signals are for the process, which ends in its own way."""
    signal.signal(signal.SIGTERM, lambda *_: process.terminate())
    while True:
        try:
            return process.wait()
        except KeyboardInterrupt:
            continue


def step(
    title: str, command: list[str], *, may_fail: bool = False, log: Path | None = None
) -> bool:
    """Run it, with a sign of life; whether it succeeded. All of its output, where it did not.

    The output is also kept in the file `log`.
    """
    say(title)
    told_s = time.monotonic()
    with tempfile.TemporaryFile("w+b") as out:
        process = subprocess.Popen(command, stdout=out, stderr=subprocess.STDOUT)
        try:
            while process.poll() is None:
                time.sleep(0.05)
                if time.monotonic() - told_s >= _A_LINE_EVERY_S:
                    told_s = time.monotonic()
                    say(f"  {last_line(out.fileno())}")
        except KeyboardInterrupt:
            process.wait()
            sys.exit(130)
        out.seek(0)
        text = out.read().decode(errors="replace")
    if log is not None:
        log.write_text(text)
    if process.returncode == 0:
        return True
    if may_fail:
        say(f"  failed, go on without: {(text.strip().splitlines() or [''])[-1][:_WIDTH]}")
        return False
    sys.stderr.write(text)
    sys.exit(f"Error: this failed: {' '.join(command)}")


def last_line(out: int) -> str:
    """What the command said last; its own words, cut."""
    size = os.fstat(out).st_size
    lines = os.pread(out, 4096, max(0, size - 4096)).decode(errors="replace").splitlines()
    texts = [line.strip() for line in lines if line.strip() and not line.startswith("WARN")]
    return texts[-1][:_WIDTH] if texts else "at work"


def say(text: str) -> None:
    """A line with the seconds since the start."""
    print(f"[{time.monotonic() - _STARTED_S:3.0f} s] {text}", flush=True)


if __name__ == "__main__":
    main()
