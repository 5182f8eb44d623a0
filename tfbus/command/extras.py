"""How to install what an extra of tfbus needs, as it works for the Python that runs."""

import shutil
import sys
from importlib import metadata
from pathlib import Path

# Where tfbus is run without having been installed.
_MODULES = {
    "bag": "mcap",
    "bags": "rosbags",
    "foxglove": "websockets",
    "plot": "matplotlib",
    "robot": "xacro",
    "ros1": "rosbags",
    "ros2": "cyclonedds",
    "secure": "cryptography",
    "sim": "pygame-ce",
    "top": "textual",
    "view": "viser",
}


def install_command(extra: str) -> str:
    """The command line that installs the requirements of an extra: `pip install 'textual>=3'`.

    It names these, not tfbus: that works for a clone, an editable install and a wheel alike. If
    `pip` on PATH is not that of this Python, it begins with this Python.
    """
    requirements = " ".join(f"'{each}'" for each in _requirements(extra))
    return f"{_pip()} install {requirements}"


def _requirements(extra: str) -> list[str]:
    try:
        required = metadata.requires("tfbus") or []
    except metadata.PackageNotFoundError:
        required = []
    marker = f'extra == "{extra}"'
    found = [each.partition(";")[0].strip() for each in required if marker in each]
    return found or [_MODULES[extra]]


def _pip() -> str:
    pip = shutil.which("pip")
    is_ours = pip is not None and Path(pip).parent == Path(sys.executable).parent
    return "pip" if is_ours else f"{sys.executable} -m pip"
