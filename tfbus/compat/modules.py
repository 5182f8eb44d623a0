"""Modules with ROS's names: made from definitions of interfaces, or the same as another one.

`tfbus.compat.nav_msgs.msg` has the class Odometry without a file of its own; a module's answer to a
name that it lacks names a substitute.
"""

import importlib
import sys
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import find_spec
from types import ModuleType
from typing import Any, NoReturn

from tfbus.base.wording import did_you_mean, listed, near_names
from tfbus.ros.definitions import FOLDERS_VARIABLE, interfaces_of, packages
from tfbus.ros.message_classes import PACKAGE, interface_class


def missing_names(module: str, instead: Mapping[str, str], otherwise: str) -> Callable[[str], Any]:
    """The module's `__getattr__`: imports a module of a package when it is used first, as ROS's
    packages do at once. Its error names a substitute: `instead` by name, and `otherwise` of
    all other names that look like ROS's.
    """

    def missing(name: str) -> Any:
        if not name.startswith("_") and _is_module(f"{module}.{name}"):
            return import_module(f"{module}.{name}")
        raise_missing(module, name, instead.get(name, otherwise))

    return missing


def raise_missing(module: str, name: str, instead: str) -> NoReturn:
    """Raise the error for a name that a module has not."""
    if name.startswith("_"):  # as the import system and inspect ask of any module
        raise AttributeError(f"module {module!r} has no attribute {name!r}")
    # Of an AttributeError `from ... import` would not show the sentence.
    raise ImportError(f"{module} has no {name}: {instead}", name=name)


def _is_module(name: str) -> bool:
    try:
        return find_spec(name) is not None
    except ModuleNotFoundError:  # its parent is no package
        return False


# Packages that programs import beside tf2_ros, and their substitutes here.
_INSTEAD = {
    "tf2_kdl": "tfbus.Robot has the kinematics of a URDF",
    "tf2_eigen": "it is for C++; arrays of numpy are what transform.apply takes",
    "cv_bridge": "numpy reads an Image: numpy.frombuffer(msg.data, numpy.uint8)",
    "ament_index_python": "give the path of the file by a parameter",
    "launch": "`tfbus launch` reads launch files of its own",
    "launch_ros": "`tfbus launch` reads launch files of its own",
}


# Modules of ROS whose names are in another one here.
_SAME = {
    "rclpy.client": "rclpy.endpoints",
    "rclpy.publisher": "rclpy.endpoints",
    "rclpy.service": "rclpy.endpoints",
    "rclpy.subscription": "rclpy.endpoints",
    "rclpy.timer": "rclpy.endpoints",
    "tf2_py._tf2_py": "tf2_py",
    "transformations": "tf_transformations",
}


class _Packages(MetaPathFinder, Loader):
    """Finds packages of interfaces below tfbus.compat, and the modules in them."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if not fullname.startswith(f"{PACKAGE}."):
            return None
        below = fullname.removeprefix(f"{PACKAGE}.")
        if below in _SAME:
            return ModuleSpec(fullname, self)
        package, _, kind = below.partition(".")
        kinds = interfaces_of(package)
        if kind in kinds or (kinds and not kind):
            return ModuleSpec(fullname, self, is_package=not kind)
        if not kind and not package.startswith("_"):
            raise ModuleNotFoundError(_no_package(package), name=fullname)
        return None

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        below = spec.name.removeprefix(f"{PACKAGE}.")
        if below in _SAME:
            return _Same(spec.name, importlib.import_module(f"{PACKAGE}.{_SAME[below]}"))
        package, _, kind = below.partition(".")
        if not kind:
            return _Package(spec.name, package)
        return _Interfaces(spec.name, package, kind)

    def exec_module(self, module: ModuleType) -> None:
        """Nothing: its classes are made when they are used."""


class _Same(ModuleType):
    """A module with the names of another one."""

    def __init__(self, name: str, other: ModuleType) -> None:
        super().__init__(name, other.__doc__)
        self._other = other

    def __getattr__(self, name: str) -> Any:
        return getattr(self._other, name)


class _Package(ModuleType):
    """A package whose modules msg, srv and action are there without an import of their own."""

    def __init__(self, name: str, package: str) -> None:
        super().__init__(name, f"ROS's package {package}.")
        self._kinds = [*interfaces_of(package)]

    def __getattr__(self, name: str) -> Any:
        if name in self._kinds:
            return importlib.import_module(f"{self.__name__}.{name}")
        raise_missing(self.__name__, name, f"it has {listed(self._kinds)}")


class _Interfaces(ModuleType):
    """A module whose classes are made when they are used first."""

    def __init__(self, name: str, package: str, kind: str) -> None:
        super().__init__(name, f"ROS's {package}.{kind}.")
        self.__all__ = sorted(interfaces_of(package)[kind])
        self._before = f"{package}/{kind}/"

    def __getattr__(self, name: str) -> Any:
        if name in self.__all__:
            found = interface_class(self._before + name)
            setattr(self, name, found)
            return found
        near = near_names(name, self.__all__, most=1)
        raise_missing(
            self.__name__,
            name,
            f"{f'did you mean {near[0]}? ' if near else ''}it has {listed(self.__all__, most=60)}; "
            f"one of your own is read from a folder in {FOLDERS_VARIABLE}, or written as a "
            "dataclass with its fields",
        )

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *self.__all__]


def _no_package(package: str) -> str:
    if package in _INSTEAD:
        return f"{PACKAGE} has no {package}: {_INSTEAD[package]}"
    return (
        f"{PACKAGE} has no package {package}{did_you_mean(package, packages())}. Interfaces of "
        f"your own are read from the folders in {FOLDERS_VARIABLE}, each with packages such as "
        f"{package}/msg/Name.msg"
    )


def install() -> None:
    """Let `import` find the packages; twice is fine."""
    if not any(isinstance(each, _Packages) for each in sys.meta_path):
        sys.meta_path.append(_Packages())
