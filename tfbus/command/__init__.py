"""Shared by all command lines: options, argument types, completion.

`__all__` lists the names that nodes use, in addition to the names of `tfbus`; each is imported when
first used.
"""

from tfbus.base.lazy_exports import exported

# As in tfbus/__init__.py: names are imported when first used.
TYPE_CHECKING = False

if TYPE_CHECKING:
    from tfbus.base.installation import install_command as install_command
    from tfbus.base.whole_file import replacing as replacing
    from tfbus.base.yaml_file import Value as Value
    from tfbus.base.yaml_file import YamlFileError as YamlFileError
    from tfbus.base.yaml_file import read_yaml_file as read_yaml_file
    from tfbus.command.names import namespaces_serving as namespaces_serving
    from tfbus.command.options import max_gap_option as max_gap_option
    from tfbus.command.options import roster_option as roster_option
    from tfbus.command.parameters import Declared as Declared
    from tfbus.command.parameters import NodeCommand as NodeCommand
    from tfbus.command.recordings import BagChoice as BagChoice
    from tfbus.command.recordings import bag_options as bag_options
    from tfbus.command.server import ServerOptions as ServerOptions
    from tfbus.command.server import server_options as server_options
    from tfbus.command.terminal import KeyReader as KeyReader
    from tfbus.command.terminal import NoTerminalError as NoTerminalError
    from tfbus.command.terminal import RawTerminal as RawTerminal
    from tfbus.command.types import POSITIVE as POSITIVE
    from tfbus.command.types import Moment as Moment
    from tfbus.command.types import MomentType as MomentType
    from tfbus.command.types import OutputFile as OutputFile
    from tfbus.command.types import frame_mistake as frame_mistake
    from tfbus.command.types import own_name as own_name

_MODULE_OF = {
    "bag_options": "tfbus.command.recordings",
    "BagChoice": "tfbus.command.recordings",
    "POSITIVE": "tfbus.command.types",
    "Declared": "tfbus.command.parameters",
    "ServerOptions": "tfbus.command.server",
    "server_options": "tfbus.command.server",
    "KeyReader": "tfbus.command.terminal",
    "NoTerminalError": "tfbus.command.terminal",
    "NodeCommand": "tfbus.command.parameters",
    "Moment": "tfbus.command.types",
    "MomentType": "tfbus.command.types",
    "OutputFile": "tfbus.command.types",
    "RawTerminal": "tfbus.command.terminal",
    "Value": "tfbus.base.yaml_file",
    "YamlFileError": "tfbus.base.yaml_file",
    "frame_mistake": "tfbus.command.types",
    "max_gap_option": "tfbus.command.options",
    "roster_option": "tfbus.command.options",
    "install_command": "tfbus.base.installation",
    "namespaces_serving": "tfbus.command.names",
    "own_name": "tfbus.command.types",
    "read_yaml_file": "tfbus.base.yaml_file",
    "replacing": "tfbus.base.whole_file",
}

__all__ = sorted(_MODULE_OF)
__getattr__, __dir__ = exported(__name__, _MODULE_OF)
