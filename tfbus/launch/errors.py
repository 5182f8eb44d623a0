"""Mistakes of a launch, besides mistakes in its files (YamlFileError)."""

from tfbus.errors import TfbusError


class LaunchError(TfbusError):
    """A launch file that cannot be found, or not be launched as asked."""


class LaunchArgumentError(LaunchError):
    """An argument that a launch file does not know, does not allow, or lacks.

    `argument` is its name.
    """

    def __init__(self, argument: str, reason: str) -> None:
        super().__init__(reason)
        self.argument = argument
