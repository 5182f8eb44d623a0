"""The version of the installed tfbus."""

from importlib.metadata import version

VERSION = version("tfbus")
