"""The needs of some tests: on a machine that lacks one, they skip and name it.

Every such reason reads `needs X` or `needs X: how to get it`; the summary of a run counts the
skipped tests by X.
"""

import os
import shutil
import subprocess
from collections import Counter
from collections.abc import Iterable
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any, NoReturn

import pytest

# The program, what people call it, and how Debian has it.
_PROGRAMS = {
    "cc": ("a C compiler", "gcc"),
    "chromium": ("Chromium", "chromium"),
    "fish": ("fish", "fish"),
    "ip": ("network namespaces", "iproute2"),
    "tmux": ("tmux", "tmux"),
    "Xvfb": ("Xvfb", "xvfb"),
    "zsh": ("zsh", "zsh"),
}

# Modules whose packages have other names.
_PACKAGES = {"cv2": "opencv-python-headless"}


def skip(need: str, how: str = "") -> NoReturn:
    """Skip the test that runs, which needs this."""
    pytest.skip(f"needs {need}: {how}" if how else f"needs {need}")


def program(name: str) -> str:
    """The path of a program; the test is skipped where it is not on PATH."""
    path = shutil.which(name)
    if path is None:
        need, package = _PROGRAMS.get(name, (name, name))
        skip(need, f"apt-get install {package}")
    return path


def module(name: str) -> Any:
    """A module that some tests use; the test is skipped where it is not installed."""
    try:
        return import_module(name)
    except ImportError:
        top = name.partition(".")[0]
        skip(name, f"pip install {_PACKAGES.get(top, top)}")


@cache
def _python_with(modules: str) -> str | None:
    env = {name: text for name, text in os.environ.items() if not name.startswith("PYTHON")}
    for folder in os.environ["PATH"].split(os.pathsep):
        python = Path(folder) / "python3"
        if python.exists():
            imports = [str(python), "-c", f"import {modules}"]
            if subprocess.run(imports, env=env, capture_output=True).returncode == 0:
                return str(python)
    return None


def python_of_tf2(*, messages: bool = False) -> str:
    """A Python on PATH that has the real tf2, and sensor_msgs with `messages`; the test is skipped
    where there is none.
    """
    python = _python_with("rospy, tf2_py, sensor_msgs.msg" if messages else "rospy, tf2_py")
    if python is None:
        packages = "python3-tf2 python3-tf2-ros" + " python3-sensor-msgs" * messages
        skip("tf2", f"apt-get install {packages} (Debian, Ubuntu)")
    return python


def python_of_rosbag() -> str:
    """A Python on PATH that has ROS 1's own rosbag; the test is skipped where there is none."""
    python = _python_with("rosbag, tf2_msgs.msg")
    if python is None:
        skip("rosbag", "apt-get install python3-rosbag python3-tf2-ros (Debian, Ubuntu)")
    return python


def python_of_ros2(distro: str) -> str:
    """The Python of an environment with ROS 2 of this distribution, and tfbus behind it; the test
    is skipped where there is none.
    """
    variable = f"TFBUS_ROS2_{distro.upper()}"
    folder = os.environ.get(variable)
    if not folder:
        skip(f"ROS 2 {distro}", f"{variable}, made by tests/ros/bridge/ros2_environment.sh")
    return str(Path(folder, "bin", "python"))


def python_of_rmw_zenoh() -> str:
    """The Python of an environment with pyzeros and zenoh-ros2-sdk, two implementations of
    rmw_zenoh's wire; the test is skipped where there is none.
    """
    return _python_of("TFBUS_RMW", "pyzeros", "pip install pyzeros zenoh-ros2-sdk")


def python_of_old_zenoh() -> str:
    """The Python of an environment with the Zenoh that is in ROS; the test is skipped where there
    is none.
    """
    return _python_of("TFBUS_OLD_ZENOH", "Zenoh 1.6", "pip install eclipse-zenoh==1.6.2")


def _python_of(variable: str, need: str, install: str) -> str:
    folder = os.environ.get(variable, "")
    if not folder:
        skip(need, f"{install} in an environment of its own, and {variable}=ITS_FOLDER")
    return str(Path(folder) / "bin" / "python")


@cache
def why_no_hosts() -> str:
    """Why network namespaces cannot be made here; "" where they can."""
    if os.geteuid() != 0:
        return "needs network namespaces: run as root"
    if shutil.which("ip") is None:
        return "needs network namespaces: apt-get install iproute2"
    probe = f"tfbus-{os.getpid()}-probe"
    for verb in ("add", "del"):
        done = subprocess.run(["ip", "netns", verb, probe], capture_output=True, text=True)
        if done.returncode:
            return f"needs network namespaces: {done.stderr.strip()}"
    return ""


def summary(reasons: Iterable[str]) -> str:
    """One line on the tests that were skipped for want of something; "" where none was."""
    wanted = Counter(
        reason.partition("needs ")[2].partition(":")[0] for reason in reasons if "needs " in reason
    )
    if not wanted:
        return ""
    counts = ", ".join(f"{need} {count}" for need, count in sorted(wanted.items()))
    return f"skipped for want of: {counts}"
