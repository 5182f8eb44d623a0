"""Writes docs/reference/api.md, the reference of all public names: `make docs-api`.

Signatures and docstrings are read from the source, so that the page is the same whether the
package is compiled or not.
"""

import ast
import inspect
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pathlib import Path
from types import ModuleType

import tfbus
import tfbus.buffer.files
import tfbus.buffer.formats
import tfbus.buffer.trajectories
import tfbus.inspect
import tfbus.messages
import tfbus.sensor_files
import tfbus.testing
import tfbus.view
from tfbus.base.structs import Struct
from tfbus.view import View

PAGE = Path(__file__).parent / "reference" / "api.md"
PACKAGE = Path(tfbus.__file__).parent

# The order of the page. A public name that is not listed comes at the end.
GROUPS = {
    "A process": "Node NodeSettings Limits Parameter GoalHandle GoalResult",
    "Transforms out": "TransformBroadcaster StaticTransformBroadcaster",
    "Transforms in": "TransformListener Fleet",
    "The buffer": "Buffer Sampling FrameInfo Change Trajectory",
    "Values": "Transform TransformStamped TransformArray TransformBatch TwistStamped",
    "Time": "stamp_ns SystemClock SimulatedClock",
    "Command lines": "node_options fleet_options FrameName NodeName TopicName ServiceName Number",
    "Errors": "TfbusError TransformException InvalidArgumentException LookupException"
    " ConnectivityException NoDataException ExtrapolationException PastExtrapolationException"
    " FutureExtrapolationException SingleSampleException GapException LoopException StaleException"
    " TimeoutException BusError DecodeError InvalidNameError ParameterError ServiceError"
    " SettingsError",
}

# Methods with underscores that people call all the same, by their operators.
_OPERATORS = {"__matmul__", "__invert__", "__call__", "__getitem__", "__iter__", "__len__"}

_HEAD = """\
# API reference

All public names, generated from their docstrings by `make docs-api`. Import them from `tfbus`, or
from the module in the heading. Lengths are metres, angles radians, quaternions x, y, z, w, and
stamps (`stamp_ns`) integer nanoseconds since the Unix epoch. A method without an arrow returns
None; `Name.method` makes a Name. An argument without a type is a str, or of the type of its
default. A text that holds for several methods stands at the first.
"""


_VIEW = """\
A page of a buffer or a recording, with what a program draws; it needs the extra `view`. See [the
guide](../guide/view.md).
"""

# Methods and constructors that only other parts of tfbus call, by their class: a listener, the
# waits of the clock, the simulated network, the completion of a shell.
_INNER = {
    "Buffer": "announce ask_again count_sent_by expect_no_more expect_past forget interrupt"
    " known_frame mark_gone remove_sent senders_of sent_by waiting watch_questions",
    "tfbus.buffer.formats": "branch",
    "tfbus.sensor_files": "read_compressed_image read_image write_cloud_npz write_jpeg write_pcd"
    " write_pixels_npy write_ply write_png",
    "Node": "buffers describe describers",
    "NodeSettings": "check_right named_by_default renamed",
    "Limits": "limit_of mistake_in",
    "Parameter": "__init__ checked describe",
    "GoalHandle": "__init__",
    "Robot": "__init__",
    "TransformListener": "where_to_look",
    "Fleet": "names",
    "SimulatedClock": "call_at call_when_running cancel limit",
    "Clock": "call_when_running limit",
    "SystemClock": "call_when_running limit",
    "FrameName": "candidates convert shell_complete",
    "NodeName": "candidates convert shell_complete",
    "TopicName": "candidates convert shell_complete",
    "ServiceName": "candidates convert shell_complete",
    "Number": "convert",
    "Recording": "of_reader",
    "BusMoment": "since",
    "Network": "tasks",
    "Process": "at_exit call_at_exit enter forget_at_exit go_on handler leave object_of receive"
    " set_handler urandom",
    "Program": "enter leave run",
}

# A class whose methods are those of another, row by row or of a file: where both have one, the
# text stands at the other, but for these.
_LIKE: dict[type, tuple[type, set[str]]] = {
    tfbus.TransformArray: (tfbus.Transform, {"apply", "from_matrix", "from_rpy", "rotate"}),
    tfbus.Recording: (tfbus.Buffer, {"frames", "samples", "trajectory"}),
}

_MESSAGES = """\
[Messages](messages.md) has their fields, and `tfbus topic show NAME` prints types and defaults. A
value that is not finite or out of range raises ValueError; on the bus such a message is dropped.
"""

_TESTING = """\
A simulated network for tests, and the fixture `network` of pytest. See [the
guide](../guide/testing.md).
"""


_INSPECT = """\
The bus at one moment, live or recorded, and its changes. See [the
guide](../guide/tools.md#in-python). `Endpoint`, `NodeDescription`, `ServiceInfo`, `StreamInfo` and
`TopicInfo` are there for annotations; `tfbus node info --json` has the fields of a node.
"""


@dataclass(frozen=True)
class Member:
    """A method, property or field, and what it says of itself."""

    name: str
    signature: str
    text: str


def page() -> str:
    """The whole page."""
    listed = {name for names in GROUPS.values() for name in names.split()}
    groups = {title: names.split() for title, names in GROUPS.items()}
    groups["Others"] = sorted(set(tfbus.__all__) - listed)
    parts = [_HEAD]
    for title, names in groups.items():
        if names:
            parts += [f"## {title}\n", *(_entry(name, getattr(tfbus, name)) for name in names)]
    parts += ["## What these hand out\n", "Made by the methods above, not by constructors.\n"]
    returned = _returned()
    parts += [
        _entry(value.__name__, value, made=False)
        for value in sorted(returned, key=lambda value: value.__name__)
    ]
    parts += ["## tfbus.testing\n", _TESTING]
    for name in tfbus.testing.__all__:
        value = getattr(tfbus.testing, name)
        parts.append(_entry(name, value, made=name in ("Network", "Faults")))
    parts += ["## tfbus.inspect\n", _INSPECT]
    for value in (tfbus.inspect.Watch, tfbus.inspect.Recorded):
        parts.append(_entry(value.__name__, value))
    for name in ("BusMoment", "FrameStatus", "Problem", "BusChange"):
        value = getattr(tfbus.inspect, name)
        members = ", ".join(f"`{member.signature}`" for member in _members(value))
        parts += [f"### {name}\n", _paragraphs(_docstring(value))]
        parts += [f"- {members}\n"] if members else []
    parts += ["## tfbus.view\n", _VIEW]
    parts += [_entry(value.__name__, value, made=False) for value in (tfbus.view.show, View)]
    modules = tfbus.buffer.files, tfbus.buffer.formats, tfbus.buffer.trajectories
    for module in (*modules, tfbus.sensor_files):
        parts += [f"## {module.__name__}\n", _paragraphs(module.__doc__ or "")]
        parts += [_entry(name, value) for name, value in _functions(module)]
    parts += ["## tfbus.messages\n", _MESSAGES]
    parts += [
        f"### {name}\n"
        for name, value in vars(tfbus.messages).items()
        if inspect.isclass(value) and value.__module__.startswith("tfbus.messages")
    ]
    return _each_text_once("\n".join(parts))


def _each_text_once(text: str) -> str:
    """The page without the texts of methods that stand on it already."""
    seen: set[str] = set()

    def kept(item: re.Match[str]) -> str:
        if item["text"] in seen:
            return item["signature"]
        seen.add(item["text"])
        return item[0]

    return re.sub(
        r"^(?P<signature>- `.*`\n)\n(?P<text>(?:    .*\n|\n(?=    ))+)", kept, text, flags=re.M
    )


def _entry(name: str, value: object, *, made: bool = True) -> str:
    if not inspect.isclass(value):
        node = _definition(value.__module__, name)
        return f"### {name}\n\n{_item(_function(node, name))}"
    parts = [f"### {name}\n"]
    bases = [base.__name__ for base in value.__bases__ if _is_ours(base) and base in _public()]
    if bases:
        parts.append(f"A {' and '.join(f'`{base}`' for base in bases)}.\n")
    parts.append(_paragraphs(_docstring(value)))
    made = made and not issubclass(value, Exception)
    if made and "__init__" not in _INNER.get(name, "") and (signature := _constructor(value)):
        parts.append(f"- `{name}({signature})`\n")
    for nested in vars(value).values():
        if inspect.isclass(nested) and nested.__qualname__ == f"{value.__name__}.{nested.__name__}":
            signature = f"{nested.__qualname__}({_constructor(nested)})"
            parts.append(_item(Member(nested.__name__, signature, _docstring(nested))))
    parts += [_item(member) for member in _members(value)]
    if shared := _shared(value):
        other, _ = _LIKE[value]
        names = ", ".join(f"`{name}`" for name in shared)
        parts.append(f"As of `{other.__name__}`: {names}.\n")
    return "\n".join(part for part in parts if part)


def _public() -> set[object]:
    return {getattr(tfbus, name) for name in tfbus.__all__}


def _item(member: Member) -> str:
    text = "\n".join(f"    {line}".rstrip() for line in member.text.splitlines())
    return f"- `{member.signature}`\n" + (f"\n{text}\n" if text else "")


def _functions(module: ModuleType) -> list[tuple[str, object]]:
    """The public functions that a module defines, in its order."""
    return [
        (name, value)
        for name, value in vars(module).items()
        if inspect.isfunction(value)
        and value.__module__ == module.__name__
        and name[0] != "_"
        and name not in _INNER.get(module.__name__, "")
    ]


def _paragraphs(text: str) -> str:
    return f"{inspect.cleandoc(text)}\n" if text else ""


def _docstring(value: type) -> str:
    return ast.get_docstring(_definition(value.__module__, value.__qualname__)) or ""


def _is_ours(value: type) -> bool:
    return value.__module__.partition(".")[0] == "tfbus"


def _definition(module: str, qualname: str) -> ast.ClassDef | ast.FunctionDef:
    """Where a class or function is defined, in the source."""
    names = module.split(".")[1:]
    file = PACKAGE.joinpath(*names)
    file = file / "__init__.py" if file.is_dir() else file.with_suffix(".py")
    node = _tree(file)
    for name in qualname.split("."):
        node = next(
            child
            for child in ast.walk(node)
            if isinstance(child, ast.ClassDef | ast.FunctionDef)
            and child.name == name
            and not _is_overload(child)
        )
    assert isinstance(node, ast.ClassDef | ast.FunctionDef)
    return node


@cache
def _tree(file: Path) -> ast.AST:
    """The syntax tree of a file, which holds many definitions."""
    return ast.parse(file.read_text())


def _is_overload(node: ast.ClassDef | ast.FunctionDef) -> bool:
    """Whether it is one of the signatures of a function that follows."""
    return any(ast.unparse(decorator) == "overload" for decorator in node.decorator_list)


def _bodies(value: type) -> Iterator[ast.ClassDef]:
    """A class and its bases of tfbus, the class first; `Struct` is how it is made."""
    for base in value.__mro__:
        if _is_ours(base) and base is not Struct:
            node = _definition(base.__module__, base.__qualname__)
            assert isinstance(node, ast.ClassDef)
            yield node


def _shared(value: type) -> list[str]:
    """The methods whose texts stand at another class, in the order of the source."""
    if value not in _LIKE:
        return []
    other, own = _LIKE[value]
    names = dict.fromkeys(
        node.name
        for body in _bodies(value)
        for node in body.body
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and _is_public(node)
    )
    return [name for name in names if hasattr(other, name) and name not in own and name[0] != "_"]


def _members(value: type) -> list[Member]:
    """The methods and properties with a docstring, each as its most derived class says it; without
    those of a base that has an entry of its own, and properties that the text of the class has,
    unless they can be set.
    """
    found: dict[str, Member] = {}
    inherited: dict[str, Member] = {}
    inner = _INNER.get(value.__name__, "").split()
    shared = _shared(value)
    for body in _bodies(value):
        for node in body.body:
            if (
                isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
                and _is_public(node)
                and node.name not in (*inner, *shared)
            ):
                into = found if body.name == value.__name__ else inherited
                into.setdefault(node.name, _function(node, value.__name__))
    head, settable = _docstring(value), _settable(value)
    said = [
        each
        for name, each in found.items()
        if (each.text or name not in inherited)
        and (name in settable or "(" in each.signature or f"`{name}`" not in head)
    ]
    listed = {name for base in value.__bases__ if base in _public() for name in dir(base)}
    return [*said, *(inherited[name] for name in inherited if name not in {*found, *listed})]


def _settable(value: type) -> set[str]:
    """The names of the properties that can be set."""
    return {
        node.name
        for body in _bodies(value)
        for node in body.body
        if isinstance(node, ast.FunctionDef)
        and any(ast.unparse(each) == f"{node.name}.setter" for each in node.decorator_list)
    }


def _is_public(node: ast.FunctionDef | ast.AsyncFunctionDef) -> bool:
    return not node.name.startswith("_") or (
        node.name in _OPERATORS and ast.get_docstring(node) is not None
    )


def _function(node: ast.AST, owner: str) -> Member:
    assert isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
    kinds = {ast.unparse(decorator) for decorator in node.decorator_list}
    returned = _plain(node.returns)
    returns = f" -> {returned}" if returned not in ("", "None") else ""
    text = ast.get_docstring(node) or ""
    if kinds & {"property", "cached_property"}:
        return Member(node.name, f"{node.name}{returns.replace(' ->', ':')}", text)
    prefix = f"{owner}." if kinds & {"staticmethod", "classmethod"} else ""
    if prefix and returned in (owner, "Self"):
        returns = ""
    word = "await " if isinstance(node, ast.AsyncFunctionDef) else ""
    return Member(node.name, f"{word}{prefix}{node.name}({_arguments(node.args)}){returns}", text)


def _constructor(value: type) -> str:
    """The arguments of the constructor: of `__init__`, or the fields."""
    for body in _bodies(value):
        for node in body.body:
            if isinstance(node, ast.FunctionDef) and node.name == "__init__":
                return _arguments(node.args)
    return ", ".join(_fields(value))


def _fields(value: type) -> list[str]:
    """The annotated fields of a dataclass or named tuple, those of its bases first."""
    found = []
    for body in reversed(list(_bodies(value))):
        for node in body.body:
            if isinstance(node, ast.AnnAssign) and not ast.unparse(node.target).startswith("_"):
                default = _default(node.value) if node.value else ""
                found.append(_named(ast.unparse(node.target), node.annotation, default))
    return found


def _default(node: ast.expr) -> str:
    """A default value; of a field with a factory, what that makes."""
    if isinstance(node, ast.Call) and ast.unparse(node.func) == "field":
        given = {keyword.arg: ast.unparse(keyword.value) for keyword in node.keywords}
        factory = given.get("default_factory", "")
        return given.get("default") or (f"{factory}()" if factory.isidentifier() else "...")
    return ast.unparse(node)


def _arguments(arguments: ast.arguments) -> str:
    """The arguments as they are written, without `self` and quotes around types."""
    plain = [*arguments.posonlyargs, *arguments.args]
    defaults = [None] * (len(plain) - len(arguments.defaults)) + arguments.defaults
    written = [_argument(*pair) for pair in zip(plain, defaults, strict=True)]
    if plain and plain[0].arg in ("self", "cls"):
        del written[0]
    if arguments.vararg:
        written.append(f"*{_argument(arguments.vararg, None)}")
    elif arguments.kwonlyargs:
        written.append("*")
    written += map(_argument, arguments.kwonlyargs, arguments.kw_defaults)
    if arguments.kwarg:
        written.append(f"**{_argument(arguments.kwarg, None)}")
    return ", ".join(written)


def _argument(argument: ast.arg, default: ast.expr | None) -> str:
    return _named(argument.arg, argument.annotation, ast.unparse(default) if default else "")


def _named(name: str, annotation: ast.expr | None, default: str) -> str:
    """A parameter or field; a number, a text, True or False as the default says its type, and a str
    without a default has none.
    """
    kind = _plain(annotation)
    if not default:
        is_told = kind == "str"
    else:
        is_told = default[0] in "'(-0123456789" or default in ("True", "False")
    return f"{name}{'' if is_told or not kind else f': {kind}'}{f'={default}' if default else ''}"


def _plain(annotation: ast.expr | None) -> str:
    text = ast.unparse(annotation) if annotation else ""
    return text.replace("'", "").replace(" | ", "|")


def _returned() -> set[type]:
    """The classes that a node and a listener hand out, and those that these hand out."""
    found: set[type] = set()
    ahead: list[tuple[type, str]] = [(tfbus.Node, "create_"), (tfbus.TransformListener, "streams")]
    while ahead:
        for name, module in _names_returned(*ahead.pop()):
            value = _known_in(module, name)
            if inspect.isclass(value) and _is_ours(value) and value not in found:
                found.add(value)
                ahead.append((value, ""))
    return found - _public()


def _known_in(module: str, name: str) -> object:
    """What a name is in a module, also where it is imported for the checker of types only."""
    for node in ast.walk(_tree(Path(inspect.getfile(sys.modules[module])))):
        if isinstance(node, ast.ImportFrom) and any(each.name == name for each in node.names):
            return getattr(import_module(str(node.module)), name)
    return getattr(sys.modules[module], name, None)


def _names_returned(value: type, prefix: str) -> Iterator[tuple[str, str]]:
    """The names in what methods of a class return, and the module where each is known."""
    for base in value.__mro__:
        if _is_ours(base):
            import_module(base.__module__)
            node = _definition(base.__module__, base.__qualname__)
            for method in node.body:
                if (
                    isinstance(method, ast.FunctionDef)
                    and _is_public(method)
                    and method.name.startswith(prefix)
                ):
                    for part in ast.walk(ast.parse(_plain(method.returns))):
                        if isinstance(part, ast.Name):
                            yield part.id, base.__module__


if __name__ == "__main__":
    PAGE.write_text(page())
