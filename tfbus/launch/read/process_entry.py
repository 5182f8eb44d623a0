"""An entry under `nodes:` of a launch file, read into a Process."""

from dataclasses import dataclass
from pathlib import Path

from tfbus.errors import TfbusError
from tfbus.launch.description import Process, Respawn
from tfbus.launch.read.fields import Fields
from tfbus.launch.read.substitution import Scope
from tfbus.runtime.yaml_file import Place, Value
from tfbus.secure.folder import open_folder
from tfbus.wire.keys import check_namespace, check_node_name, resolve

_KEYS = (
    *("node", "command", "name", "namespace", "parameters", "remappings", "arguments"),
    *("environment", "directory", "respawn", "required", "after", "secure"),
)
_KEYS_OF_NODES_ONLY = ("parameters", "remappings")
_RESPAWN_KEYS = ("delay", "limit")


@dataclass(frozen=True, slots=True)
class ProcessEntry:
    """A process as written: whether it is on, and the names in its `after:`.

    `file_namespace` is the namespace of the whole file.
    """

    process: Process
    is_on: bool
    file_namespace: str
    after: tuple[tuple[str, Place], ...]


def read_process(value: Value, scope: Scope, file_namespace: str, folder: Path) -> ProcessEntry:
    """The process described by an entry; paths in it are relative to `folder`."""
    if not value.is_mapping:
        raise value.place.mistake("must be a mapping with 'node' or 'command'")
    fields = Fields(value, _KEYS, scope)
    _check_program(fields)
    node, command = _node(fields, folder), fields.words("command")
    process = Process(
        name=_name(fields, node, command),
        namespace=joined(file_namespace, fields.text("namespace", check_namespace)),
        place=fields.place,
        directory=_directory(fields, folder),
        node=node,
        command=command,
        parameters=fields.pairs("parameters"),
        remappings=_remappings(fields),
        arguments=fields.words("arguments"),
        environment=fields.pairs("environment"),
        respawn=_respawn(fields),
        required=fields.truth("required"),
        secure=identity_folder(fields, folder),
    )
    return ProcessEntry(process, fields.is_on, file_namespace, tuple(fields.items("after")))


def joined(*namespaces: str) -> str:
    """A namespace inside another; "" stands for none."""
    return "/".join(filter(None, namespaces))


def _check_program(fields: Fields) -> None:
    if ("node" in fields) == ("command" in fields):
        raise fields.place.mistake(
            "needs either 'node' (one of tfbus) or 'command' (any program), and not both"
        )
    if "command" in fields:
        if not fields.words("command"):
            raise fields.place_of("command").mistake("is empty; name a program")
        for key in _KEYS_OF_NODES_ONLY:
            if key in fields:
                raise fields.place_of(key).mistake(
                    "is for tfbus nodes only ('node:'); write it into the command"
                )


def _node(fields: Fields, folder: Path) -> str:
    node = fields.text("node")
    if not node.endswith(".py"):
        return node
    path = folder / node
    if not path.is_file():
        raise fields.place_of("node").mistake(f"there is no file {str(path)!r}")
    return str(path.resolve())


def _name(fields: Fields, node: str, command: tuple[str, ...]) -> str:
    if "name" in fields:
        return fields.text("name", check_node_name)
    program = node or command[0]
    try:
        return check_node_name(Path(program).name.removesuffix(".py"))
    except TfbusError:
        raise fields.place_of("node" if node else "command").mistake(
            f"{program!r} cannot be the name of a process; give it a 'name'"
        ) from None


def _directory(fields: Fields, folder: Path) -> Path:
    if "directory" not in fields:
        return Path.cwd()
    directory = folder / Path(fields.text("directory")).expanduser()
    if not directory.is_dir():
        raise fields.place_of("directory").mistake(f"there is no folder {str(directory)!r}")
    return directory.resolve()


def identity_folder(fields: Fields, folder: Path) -> str:
    """The folder of an identity under `secure`; "" without one."""
    if "secure" not in fields:
        return ""
    path = folder / Path(fields.text("secure")).expanduser()
    try:
        return str(open_folder(path).path)
    except TfbusError as error:
        raise fields.place_of("secure").mistake(str(error)) from error


def _remappings(fields: Fields) -> tuple[tuple[str, str], ...]:
    pairs = fields.pairs("remappings")
    for (source, target), value in zip(pairs, fields.entries("remappings").values(), strict=True):
        for name in (source, target):
            try:
                resolve(name, "node", "")
            except TfbusError as error:
                raise value.place.mistake(str(error)) from error
    return pairs


def _respawn(fields: Fields) -> Respawn | None:
    if not fields.is_mapping("respawn"):
        return Respawn() if fields.truth("respawn") else None
    settings = fields.inner("respawn", _RESPAWN_KEYS)
    return Respawn(
        delay_s=settings.seconds("delay", Respawn().delay_s), limit=settings.count("limit")
    )
