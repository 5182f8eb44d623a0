"""Builds the kernel: modules that are compiled where there is a C compiler.

The same files run interpreted where there is none, or where TFBUS_PURE_PYTHON=1 is set at the
time of installing. The rest of the packaging is in pyproject.toml.
"""

import os

from setuptools import Extension, setup

# Beside each stands a .pxd file that says its C types.
KERNEL = ("kernel", "transform", "columns", "tree", "buffer")


def kernel_extensions() -> list[Extension]:
    if os.environ.get("TFBUS_PURE_PYTHON", "") not in ("", "0"):
        return []
    from Cython.Build import cythonize

    extensions: list[Extension] = cythonize(
        [Extension(f"tfbus.{name}", [f"tfbus/{name}.py"]) for name in KERNEL],
        build_dir="build",
        compiler_directives={
            "language_level": "3",
            "annotation_typing": False,
            "cdivision": True,
            "freethreading_compatible": True,
            "initializedcheck": False,
        },
    )
    for extension in extensions:
        # A build without a compiler warns and goes on.
        extension.optional = True
    return extensions


setup(ext_modules=kernel_extensions())
