"""Builds the kernel: modules that are compiled where there is a C compiler.

The same files run interpreted where there is none, or where TFBUS_PURE_PYTHON=1 is set at the
time of installing: all of them, or none. The rest of the packaging is in pyproject.toml.
"""

import os
import shlex
import shutil
import sys
import sysconfig
from pathlib import Path

from setuptools import Extension, find_packages, setup
from setuptools.command.build_ext import build_ext
from setuptools.errors import CCompilerError, CompileError, ExecError, PlatformError

# A .pxd file beside each has its C types, if it has any.
KERNEL = (
    "tfbus.geometry.kernel",
    "tfbus.geometry.rotations",
    "tfbus.geometry.transform",
    "tfbus.geometry.columns",
    "tfbus.wire.numbered",
    "tfbus.wire.transform_bytes",
    "tfbus.buffer.tree",
    "tfbus.buffer.insert_many",
    "tfbus.geometry.batch_lookup",
    "tfbus.buffer.lock",
    "tfbus.buffer.store",
    "tfbus.buffer.lookup",
    "tfbus.buffer.buffer",
)

# Cython's views of memory, once for all of these: 120 kB of machine code and four classes, which
# each would have for itself. Made by Cython, and without a source of ours.
SHARED = "tfbus.geometry.cython_shared"

# Those that do arithmetic on poses.
HOT = (
    "tfbus.geometry.kernel",
    "tfbus.buffer.insert_many",
    "tfbus.geometry.batch_lookup",
)

# The arithmetic of a pose is many small functions, which the compiler must inline into one, however
# large; and none of it needs the errno of a square root. Nothing here changes a result. What is not
# declared inline has a limit: without one the compiler takes three times as long, for lookups that
# are 5 % slower.
ARITHMETIC = [
    "-O3",
    "-fno-math-errno",
    "--param=max-inline-insns-single=1000",
    "--param=max-inline-insns-auto=100",
    "--param=large-function-growth=2000",
    "--param=inline-unit-growth=500",
]
# Debug information takes a third of the time to compile, and serves none who installs this.
FLAGS = ["-g0"]
# Cython returns a tuple of C that it could not convert uninitialised, together with an error.
FLAGS += ["-Wno-uninitialized", "-Wno-maybe-uninitialized", "-Wno-unknown-warning-option"]
# A build with `CFLAGS=-O0`, to try something or for sanitizers, is to be quick, and as it is asked.
if sys.platform == "win32" or "-O0" in os.environ.get("CFLAGS", ""):
    ARITHMETIC = FLAGS = []


# pip also asks for names and files, for which nothing has to be translated.
BUILDS = {"bdist_wheel", "build", "build_ext", "develop", "editable_wheel", "install"}


def compiler() -> str:
    """The command that compiles, as Python was told."""
    return shlex.split(os.environ.get("CC") or sysconfig.get_config_var("CC") or "cc")[0]


def has_compiler() -> bool:
    """False where there certainly is none."""
    return sys.platform == "win32" or shutil.which(compiler()) is not None


def c_file(name: str) -> str:
    """The C of a module."""
    return f"{name.replace('.', '/')}.c"


def kernel_extensions() -> list[Extension]:
    is_pure = os.environ.get("TFBUS_PURE_PYTHON", "") not in ("", "0")
    if is_pure or not BUILDS.intersection(sys.argv):
        return []
    if not has_compiler():
        # Nothing has to be translated: the build says that there is none.
        return [Extension(name, [c_file(name)]) for name in KERNEL]
    from Cython.Build import cythonize

    extensions: list[Extension] = cythonize(
        [
            Extension(SHARED, [c_file(SHARED)], extra_compile_args=FLAGS),
            *(
                Extension(
                    name,
                    [f"{name.replace('.', '/')}.py"],
                    extra_compile_args=[*FLAGS, *(ARITHMETIC if name in HOT else [])],
                )
                for name in KERNEL
            ),
        ],
        shared_utility_qualified_name=SHARED,
        build_dir="build",
        nthreads=0 if sys.platform == "win32" else os.cpu_count(),
        compiler_directives={
            "language_level": "3",
            "annotation_typing": False,
            "cdivision": True,
            "freethreading_compatible": True,
            # None where an object of C is expected would be read as one.
            "allow_none_for_extension_args": False,
            "initializedcheck": False,
        },
    )
    return extensions


class AllOrNothing(build_ext):
    """Builds every extension, or leaves all of them out and says so.

    Compiled and interpreted modules share numbers of C, so that a part of them is of no use.
    """

    def run(self) -> None:
        # What tells at runtime why, since pip shows nothing of this.
        reasons = [Path(folder, "tfbus", "not_compiled.txt") for folder in ("", self.build_lib)]
        for reason in reasons:
            reason.unlink(missing_ok=True)
        reason = reasons[0] if self.inplace else reasons[1]
        try:
            if not has_compiler():
                raise CompileError("there is no C compiler")
            super().run()
        except (CCompilerError, CompileError, ExecError, PlatformError, OSError) as error:
            for extension in self.extensions:
                for folder in ("", self.build_lib):
                    path = Path(folder, self.get_ext_filename(extension.name))
                    path.unlink(missing_ok=True)
            self.extensions = []
            reason.parent.mkdir(parents=True, exist_ok=True)
            why = "failed, as pip install -v shows" if has_compiler() else "is not there"
            reason.write_text(f"the C compiler '{compiler()}' {why}", encoding="utf-8")
            self.warn(
                f"tfbus is installed without its compiled kernel, about 70 times slower: {error}. "
                "Install a C compiler and the headers of Python, then tfbus again."
            )

    def build_extension(self, ext: Extension) -> None:
        # A line for who waits; in two processes, so not one that counts.
        print(f"Compile {ext.name}", flush=True)
        super().build_extension(ext)


def build() -> None:
    setup(
        # `nodes` and `configs` stand beside the library here, and inside it when installed.
        packages=[
            *find_packages(include=["tfbus", "tfbus.*"]),
            *(f"tfbus.{name}" for name in find_packages(include=["nodes", "nodes.*"])),
            "tfbus.configs",
        ],
        ext_modules=kernel_extensions(),
        cmdclass={"build_ext": AllOrNothing},
        # A compiler for each processor, instead of one file after the other.
        options={"build_ext": {"parallel": os.cpu_count()}},
    )


# The processes that translate modules import this file, on systems that do not fork.
if __name__ == "__main__":
    build()
