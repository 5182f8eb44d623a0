"""Reads a launch file into the processes that it describes.

The format is described in docs/guide/launch.md.
"""

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

from tfbus.base.errors import TfbusError
from tfbus.base.wording import did_you_mean
from tfbus.base.yaml_file import FilePlace, Value, read_yaml_file
from tfbus.bus.identity_folder import open_folder
from tfbus.bus.settings import check_network
from tfbus.launch.arguments import (
    LaunchFields,
    Scope,
    argument_values,
    declared_arguments,
    truth,
)
from tfbus.launch.description import (
    Argument,
    DescribedProcess,
    LaunchArgumentError,
    LaunchError,
    Respawn,
)
from tfbus.launch.find import find_in, find_launch_file
from tfbus.wire.descriptions import check_poses
from tfbus.wire.keys import check_namespace, check_node_name, resolve

_KEYS = (
    *("node", "command", "name", "namespace", "parameters", "remappings", "arguments"),
    *("environment", "directory", "respawn", "required", "after", "secure"),
    *("network", "poses"),
)
_KEYS_OF_NODES_ONLY = ("parameters", "remappings")
_RESPAWN_KEYS = ("delay", "limit")


@dataclass(frozen=True, slots=True)
class ProcessEntry:
    """A process as written: whether it is on, and the names in its `after:`.

    `file_namespace` is the namespace of the whole file.
    """

    process: DescribedProcess
    is_on: bool
    file_namespace: str
    after: tuple[tuple[str, FilePlace], ...]


def read_process(value: Value, scope: Scope, file_namespace: str, folder: Path) -> ProcessEntry:
    """The process described by an entry; paths in it are relative to `folder`."""
    if not value.is_mapping:
        raise value.place.mistake("must be a mapping with 'node' or 'command'")
    fields = LaunchFields(value, _KEYS, scope)
    _check_program(fields)
    node, command = _node(fields, folder), fields.words("command")
    process = DescribedProcess(
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
        network=fields.text("network", check_network),
        poses=fields.text("poses", check_poses),
    )
    return ProcessEntry(process, fields.is_on, file_namespace, tuple(fields.items("after")))


def joined(*namespaces: str) -> str:
    """A namespace inside another; "" stands for none."""
    return "/".join(filter(None, namespaces))


def _check_program(fields: LaunchFields) -> None:
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


def _node(fields: LaunchFields, folder: Path) -> str:
    node = fields.text("node")
    if not node.endswith(".py"):
        return node
    path = folder / node
    if not path.is_file():
        raise fields.place_of("node").mistake(f"there is no file {str(path)!r}")
    return str(path.resolve())


def _name(fields: LaunchFields, node: str, command: tuple[str, ...]) -> str:
    if "name" in fields:
        return fields.text("name", check_node_name)
    program = node or command[0]
    try:
        return check_node_name(Path(program).name.removesuffix(".py"))
    except TfbusError:
        raise fields.place_of("node" if node else "command").mistake(
            f"{program!r} cannot be the name of a process; give it a 'name'"
        ) from None


def _directory(fields: LaunchFields, folder: Path) -> Path:
    if "directory" not in fields:
        return Path.cwd()
    directory = folder / Path(fields.text("directory")).expanduser()
    if not directory.is_dir():
        raise fields.place_of("directory").mistake(f"there is no folder {str(directory)!r}")
    return directory.resolve()


def identity_folder(fields: LaunchFields, folder: Path) -> str:
    """The folder of an identity under `secure`; "" without one."""
    if "secure" not in fields:
        return ""
    path = folder / Path(fields.text("secure")).expanduser()
    try:
        return str(open_folder(path).path)
    except TfbusError as error:
        raise fields.place_of("secure").mistake(str(error)) from error


def _remappings(fields: LaunchFields) -> tuple[tuple[str, str], ...]:
    pairs = fields.pairs("remappings")
    for (source, target), value in zip(pairs, fields.entries("remappings").values(), strict=True):
        for name in (source, target):
            try:
                resolve(name, "node", "")
            except TfbusError as error:
                raise value.place.mistake(str(error)) from error
    return pairs


def _respawn(fields: LaunchFields) -> Respawn | None:
    if not fields.is_mapping("respawn"):
        return Respawn() if fields.truth("respawn") else None
    settings = fields.inner("respawn", _RESPAWN_KEYS)
    return Respawn(
        delay_s=settings.seconds("delay", Respawn().delay_s), limit=settings.count("limit")
    )


_FILE_KEYS = (
    "description",
    "arguments",
    "sim_time",
    "secure",
    "network",
    "poses",
    "includes",
    "nodes",
)

# Files that include others several times each grow without end.
MOST_FILES = 1_000
MOST_PROCESSES = 10_000

_INCLUDE_KEYS = ("file", "package", "namespace", "arguments")


def read_arguments(path: Path) -> tuple[Argument, ...]:
    """The arguments of a launch file itself, in its order, without included files'."""
    return _Document(path).arguments


def read_description(path: Path) -> str:
    """The description of a launch file; "" if it does not."""
    return _Document(path).description


def read_launch_file(
    path: Path,
    given: Mapping[str, str] | None = None,
    *,
    namespace: str = "",
    environment: Mapping[str, str] | None = None,
) -> tuple[DescribedProcess, ...]:
    """The processes that a launch file describes with the given arguments, all in `namespace`.

    Conditions, includes and substitutions are resolved; `${env:...}` looks in `environment`
    (`os.environ` if None). Raises LaunchArgumentError for an argument that is unknown, missing or
    not allowed, YamlFileError for a file that cannot be read, or a mistake in one.
    """
    variables = os.environ if environment is None else environment
    reading = _Reading(variables, check_namespace(namespace), (path.resolve(),), _Total())
    entries = list(reading.entries(_Document(path), given or {}))
    _check_names_differ([entry.process for entry in entries if entry.is_on])
    declared = {entry.process.full_name for entry in entries}
    processes = tuple(_with_after(entry, declared) for entry in entries if entry.is_on)
    _check_no_circle(processes)
    return processes


class _Document:
    """The parts of one launch file, before substitution."""

    def __init__(self, path: Path) -> None:
        whole = read_yaml_file(path, "a list of nodes under 'nodes'")
        fields = whole.fields(_FILE_KEYS)
        self.description = fields["description"].text() if "description" in fields else ""
        self.path = path
        self._whole = whole
        self._sim_time = fields.get("sim_time")
        self.arguments = tuple(
            declared_arguments(fields["arguments"]) if "arguments" in fields else ()
        )
        self.includes = fields["includes"].items() if "includes" in fields else []
        self.nodes = fields["nodes"].items() if "nodes" in fields else []
        if not self.includes and not self.nodes:
            raise whole.place.mistake("starts nothing; list something under 'nodes' or 'includes'")

    def has_sim_time(self, scope: Scope) -> bool:
        """Whether its nodes, and included ones, follow the topic clock."""
        value = self._sim_time
        return value is not None and truth(scope.expand(value.text(), value.place), value.place)

    def identity(self, scope: Scope) -> str:
        """The folder of the identity of its nodes, and of included ones; "" without one."""
        return identity_folder(LaunchFields(self._whole, _FILE_KEYS, scope), self.path.parent)

    def network(self, scope: Scope) -> str:
        """The network of its nodes, and of included ones; "" if it names none."""
        fields = LaunchFields(self._whole, _FILE_KEYS, scope)
        return fields.text("network", check_network)

    def poses(self, scope: Scope) -> str:
        """How precise the transforms are that its nodes, and included ones, send; "" if it does not
        say.
        """
        return LaunchFields(self._whole, _FILE_KEYS, scope).text("poses", check_poses)


class _Total:
    """The sum of all files of a launch so far."""

    def __init__(self) -> None:
        self.files = self.processes = 0

    def add_file(self, place: FilePlace) -> None:
        """Add a file. Raises YamlFileError if there are too many."""
        self.files += 1
        if self.files > MOST_FILES:
            raise place.mistake(
                f"is the include number {self.files:,} of this launch; at most {MOST_FILES:,} "
                "are read: look for files that include each other many times"
            )

    def add_process(self, place: FilePlace) -> None:
        """Add a process. Raises YamlFileError if there are too many."""
        self.processes += 1
        if self.processes > MOST_PROCESSES:
            raise place.mistake(
                f"is the process number {self.processes:,} of this launch; at most "
                f"{MOST_PROCESSES:,} are read"
            )


@dataclass(frozen=True, slots=True)
class _Reading:
    """The namespace a file is read in, and the files that include it."""

    environment: Mapping[str, str]
    namespace: str
    chain: tuple[Path, ...]  # the outermost file first, the one being read last
    total: _Total
    sim_time: bool = False
    secure: str = ""
    network: str = ""
    poses: str = ""

    def entries(self, document: _Document, given: Mapping[str, str]) -> Iterator[ProcessEntry]:
        """Every process, included files' first."""
        folder = document.path.parent
        values = argument_values(document.arguments, given, str(document.path))
        scope = Scope(values, self.environment, str(folder.resolve()))
        sim_time = document.has_sim_time(scope) or self.sim_time
        secure = document.identity(scope) or self.secure
        network = document.network(scope) or self.network
        poses = document.poses(scope) or self.poses
        within = replace(self, sim_time=sim_time, secure=secure, network=network, poses=poses)
        for include in document.includes:
            yield from within._include(include, scope, folder)
        for node in document.nodes:
            self.total.add_process(node.place)
            entry = read_process(node, scope, self.namespace, folder)
            process = replace(
                entry.process,
                sim_time=sim_time,
                secure=entry.process.secure or secure,
                network=entry.process.network or network,
                poses=entry.process.poses or poses,
            )
            yield replace(entry, process=process)

    def _include(self, value: Value, scope: Scope, folder: Path) -> Iterator[ProcessEntry]:
        if not value.is_mapping:
            raise value.place.mistake("must be a mapping with 'file', as in `- file: turtle`")
        fields = LaunchFields(value, _INCLUDE_KEYS, scope)
        if "file" not in fields:
            raise value.place.mistake("needs 'file': a name such as turtle, or a path")
        given = dict(fields.pairs("arguments"))
        if not fields.is_on:
            return
        self.total.add_file(fields.place_of("file"))
        path = self._included_path(fields, folder)
        namespace = joined(self.namespace, fields.text("namespace", check_namespace))
        inner = replace(self, namespace=namespace, chain=(*self.chain, path.resolve()))
        try:
            yield from inner.entries(_Document(path), given)
        except LaunchArgumentError as error:
            # The mistake is in this file, at its include.
            argument = fields.entries("arguments").get(error.argument)
            place = argument.place if argument else fields.place_of("arguments")
            raise place.mistake(str(error)) from error

    def _included_path(self, fields: LaunchFields, folder: Path) -> Path:
        place = fields.place_of("file")
        try:
            package, name = fields.text("package"), fields.text("file")
            path = find_in(package, name) if package else find_launch_file(name, folder)
        except LaunchError as error:
            raise place.mistake(str(error)) from error
        if path.resolve() in self.chain:
            names = [file.name for file in self.chain]
            circle = " includes ".join([*names[self.chain.index(path.resolve()) :], path.name])
            raise place.mistake(f"includes itself: {circle}")
        return path


def _check_names_differ(processes: Sequence[DescribedProcess]) -> None:
    taken: dict[str, DescribedProcess] = {}
    for process in processes:
        if process.full_name in taken:
            raise process.place.mistake(
                f"the name {process.full_name!r} is taken by {taken[process.full_name].place}; "
                "give one of them another 'name' or 'namespace'"
            )
        taken[process.full_name] = process


def _with_after(entry: ProcessEntry, declared: set[str]) -> DescribedProcess:
    """The process with full names in `after`.

    A name is looked up in the namespace of the process, then in its file's. A name
    that starts with a slash is full, and may be of a node started elsewhere.
    """
    after = []
    for name, place in entry.after:
        namespaces = (entry.process.namespace, entry.file_namespace)
        candidates = [f"/{joined(namespace, name.strip('/'))}" for namespace in namespaces]
        if name.startswith("/"):
            candidates = [name]
        elif not declared.intersection(candidates):
            raise place.mistake(
                f"no node {name!r} in this launch (for one started elsewhere, write its full "
                f"name, '/{name}'){did_you_mean(candidates[-1], declared)}"
            )
        full_name = next((name for name in candidates if name in declared), candidates[0])
        if full_name == entry.process.full_name:
            raise place.mistake(f"{full_name!r} would wait for itself")
        after.append(full_name)
    return replace(entry.process, after=tuple(after))


def _check_no_circle(processes: Sequence[DescribedProcess]) -> None:
    by_name = {process.full_name: process for process in processes}
    awaited = {name: [each for each in by_name[name].after if each in by_name] for name in by_name}
    try:
        TopologicalSorter(awaited).prepare()
    except CycleError as error:
        # Each is awaited by the next.
        names = error.args[1][::-1]
        raise by_name[names[0]].place.mistake(
            f"waits for itself: {' after '.join(names)}"
        ) from None
