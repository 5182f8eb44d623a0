"""Launch files: their processes, and the error for each mistake in one."""

import os
import re
from pathlib import Path
from textwrap import dedent

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tfbus.base.errors import TfbusError
from tfbus.base.yaml_file import FilePlace, YamlFileError
from tfbus.bus.settings import NodeSettings
from tfbus.launch import reader
from tfbus.launch.arguments import Scope, show_arguments
from tfbus.launch.child import check_startable, dry_run_line, program_of
from tfbus.launch.description import (
    Argument,
    DescribedProcess,
    LaunchArgumentError,
    LaunchError,
    Respawn,
)
from tfbus.launch.find import find_launch_file, installed_launch_files
from tfbus.launch.reader import read_arguments, read_launch_file


def write(folder: Path, text: str, name: str = "robot.yaml") -> Path:
    path = folder / name
    path.write_text(dedent(text))
    return path


def read(folder: Path, text: str, **given: str) -> tuple[DescribedProcess, ...]:
    return read_launch_file(write(folder, text), given, environment={"HOME": "/home/ada"})


# -- what a file means


@pytest.mark.parametrize(
    ("key", "one", "other"), [("network", "wifi", "mobile"), ("poses", "compact", "float32")]
)
def test_nodes_have_the_network_and_poses_of_the_file_or_their_own(
    tmp_path: Path, key: str, one: str, other: str
) -> None:
    """They are those of all nodes, also of included files, unless one names its own; any other
    name is a mistake at its place.
    """
    write(tmp_path, "nodes: [{node: simulator}]", "inner.yaml")
    text = f"includes: [{{file: inner.yaml}}]\nnodes: [{{node: a.py, {key}: {other}}}]"
    (tmp_path / "a.py").touch()
    processes = read(tmp_path, f"{key}: {one}\n{text}")
    assert [getattr(each, key) for each in processes] == [one, other]
    argv = program_of(processes[1], NodeSettings("launch")).argv
    assert argv[argv.index(f"--{key}") + 1] == other
    with pytest.raises(TfbusError, match=rf":1:.*{key} 'radio' is not "):
        read(tmp_path, f"{key}: radio\n{text}")


def test_a_node_needs_no_more_than_its_kind(tmp_path: Path) -> None:
    """`- node: simulator` is a process called `simulator` in no namespace."""
    [process] = read(tmp_path, "nodes:\n  - node: simulator\n")
    assert (process.name, process.full_name, process.node) == (
        "simulator",
        "/simulator",
        "simulator",
    )
    assert process.respawn is None and not process.required and not process.after


def test_every_key_of_a_node_is_read(tmp_path: Path) -> None:
    """All that a launch file can say of a node reaches the process."""
    [sim, process] = read(
        tmp_path,
        """
        nodes:
          - node: simulator
            name: sim
          - node: broadcaster
            name: broadcaster1
            namespace: robot7
            parameters:
              turtlename: turtle1
              rate: 10
              offset: [0.5, 'a, b']
            remappings: {turtle1/pose: pose}
            arguments: [--fast, "two words"]
            environment: {COLOUR: red}
            directory: .
            respawn: {delay: 0.5, limit: 3}
            required: true
            after: sim
        """,
    )
    assert sim.full_name == "/sim"
    assert process == DescribedProcess(
        name="broadcaster1",
        namespace="robot7",
        place=FilePlace(str(tmp_path / "robot.yaml"), 5, "nodes[1]"),
        directory=tmp_path.resolve(),
        node="broadcaster",
        parameters=(("turtlename", "turtle1"), ("rate", "10"), ("offset", '[0.5, "a, b"]')),
        remappings=(("turtle1/pose", "pose"),),
        arguments=("--fast", "two words"),
        environment=(("COLOUR", "red"),),
        respawn=Respawn(delay_s=0.5, limit=3),
        required=True,
        after=("/sim",),
    )


@pytest.mark.parametrize("command", ["[echo, two words]", "echo 'two words'"])
def test_a_command_is_a_list_or_a_text_split_as_by_a_shell(tmp_path: Path, command: str) -> None:
    """Any program can be started, by a list of words or by a text that is split into words."""
    [process] = read(tmp_path, f"nodes:\n  - command: {command}\n")
    assert process.command == ("echo", "two words")
    assert process.name == "echo"


def test_substitution_does_not_split_words(tmp_path: Path) -> None:
    """A value with a space in it stays one word of a command."""
    text = "arguments: {who: }\nnodes:\n  - command: echo ${who}\n"
    [process] = read(tmp_path, text, who="you and me")
    assert process.command == ("echo", "you and me")


def test_a_node_may_be_a_python_file_beside_the_launch_file(tmp_path: Path) -> None:
    """`node: my_node.py` is one's own node, found beside the launch file."""
    node = write(tmp_path, "", "my_node.py")
    [process] = read(tmp_path, "nodes:\n  - node: my_node.py\n")
    assert (process.node, process.name) == (str(node.resolve()), "my_node")


@pytest.mark.parametrize(
    ("written", "meant"),
    [
        ("${turtle}", "turtle1"),
        ("${ turtle }/pose", "turtle1/pose"),
        ("${env:HOME}/x", "/home/ada/x"),
        ("${env:NOWHERE:there}", "there"),
        ("${env:NOWHERE:}", ""),
        ("$${turtle}", "${turtle}"),
        ("$5 and $HOME", "$5 and $HOME"),
        ("${turtle}${turtle}", "turtle1turtle1"),
        ("${here}", "/files"),
    ],
)
def test_substitutions(written: str, meant: str) -> None:
    """Arguments, environment variables and the file's folder stand between `${` and `}`."""
    scope = Scope({"turtle": "turtle1"}, {"HOME": "/home/ada"}, "/files")
    assert scope.expand(written, FilePlace("f", 1)) == meant


@given(st.text())
def test_what_comes_in_is_not_substituted_again(value: str) -> None:
    """An argument's value is taken as it is, whatever is in it."""
    scope = Scope({"x": value}, {}, "/files")
    assert scope.expand("<${x}>", FilePlace("f", 1)) == f"<{value}>"


@given(st.text())
def test_any_text_expands_or_is_a_mistake_with_its_place(text: str) -> None:
    """Any text is substituted, or raises an error with its place."""
    try:
        Scope({}, {}, "/files").expand(text, FilePlace("f", 3, "nodes"))
    except YamlFileError as error:
        assert str(error).startswith("f:3: nodes: ")


@pytest.mark.parametrize(
    ("condition", "holds"),
    [
        ("true", True),
        ("Off", False),
        ("${yes}", True),
        ("${style} == foxy", True),
        ("${style} != foxy", False),
        ("${style} == ", False),
        ("'${style}' == 'foxy'", True),
    ],
)
def test_conditions(tmp_path: Path, condition: str, holds: bool) -> None:
    """`if:` takes a word for true or false, or compares two texts; `unless:` is its opposite."""
    for key, expected in (("if", holds), ("unless", not holds)):
        text = f"""
            arguments: {{style: {{default: foxy}}, yes: {{default: yes}}}}
            nodes:
              - node: simulator
              - node: echo
                {key}: "{condition}"
        """
        names = [process.name for process in read(tmp_path, text)]
        assert names == ["simulator", "echo"][: 2 if expected else 1]


def test_two_ways_of_one_node_may_exclude_each_other(tmp_path: Path) -> None:
    """A name can be written twice if conditions leave one of the two."""
    text = """
        arguments: {headless: {default: false}}
        nodes:
          - {node: simulator, name: sim, arguments: [--headless], if: "${headless}"}
          - {node: simulator, name: sim, unless: "${headless}"}
    """
    assert [p.arguments for p in read(tmp_path, text)] == [()]
    assert [p.arguments for p in read(tmp_path, text, headless="true")] == [("--headless",)]


def test_an_include_comes_with_arguments_and_a_namespace(tmp_path: Path) -> None:
    """A file can be included twice, in namespaces of their own, inside that of the launch."""
    write(
        tmp_path,
        """
        arguments: {turtle: {default: turtle1}}
        nodes:
          - {node: simulator, name: sim}
          - {node: broadcaster, parameters: {turtlename: "${turtle}"}, after: sim}
        """,
        "one.yaml",
    )
    path = write(
        tmp_path,
        """
        arguments: {second: {default: bob}}
        includes:
          - {file: one.yaml, namespace: a}
          - {file: ./one.yaml, namespace: b, arguments: {turtle: "${second}"}}
          - {file: nowhere.yaml, if: false}
        nodes:
          - {node: echo, after: [a/sim, /elsewhere/sim]}
        """,
    )
    processes = read_launch_file(path, namespace="/fleet/")
    assert [p.full_name for p in processes] == [
        "/fleet/a/sim",
        "/fleet/a/broadcaster",
        "/fleet/b/sim",
        "/fleet/b/broadcaster",
        "/fleet/echo",
    ]
    assert [p.parameters for p in processes][1::2] == [
        (("turtlename", "turtle1"),),
        (("turtlename", "bob"),),
    ]
    assert [p.after for p in processes] == [
        (),
        ("/fleet/a/sim",),
        (),
        ("/fleet/b/sim",),
        ("/fleet/a/sim", "/elsewhere/sim"),
    ]


def test_after_looks_in_the_namespace_of_the_node_first(tmp_path: Path) -> None:
    """A name in `after:` is looked up in the node's namespace, then in its file's."""
    text = """
        nodes:
          - {node: simulator, name: sim}
          - {node: simulator, name: sim, namespace: a}
          - {node: echo, namespace: a, after: sim}
          - {node: echo, namespace: b, after: sim}
    """
    assert [p.after for p in read(tmp_path, text)][2:] == [("/a/sim",), ("/sim",)]


def test_a_node_that_is_switched_off_here_may_be_awaited(tmp_path: Path) -> None:
    """`after:` may name a node of the file that a condition leaves to another machine."""
    text = """
        nodes:
          - {node: simulator, name: sim, if: false}
          - {node: echo, after: sim}
    """
    assert [p.after for p in read(tmp_path, text)] == [("/sim",)]


def test_respawn_backs_off_up_to_its_limit() -> None:
    """Each respawn in a row waits twice as long as the one before, half a minute at most."""
    respawn = Respawn(delay_s=1.0, limit=8)
    delays = [respawn.delay_before(n) for n in range(9)]
    assert delays == [1.0, 2.0, 4.0, 8.0, 16.0, 30.0, 30.0, 30.0, None]


@given(st.integers(0, 10**6), st.floats(0, 1e6))
def test_a_respawn_without_limit_never_ends_and_never_hurries(n: int, delay_s: float) -> None:
    """Without a limit there is always a next time, and no sooner than the first."""
    again = Respawn(delay_s=delay_s).delay_before(n)
    assert again is not None and again >= delay_s


# -- mistakes: line, key, cause and remedy

MISTAKES = [
    ("{}", "1", "starts nothing"),
    ("", "1", "is empty"),
    ("nodes: []", "1", "starts nothing"),
    ("- a", "1", "must be a mapping"),
    ("nodes:\n  - {node: [}", "2", "is not YAML"),
    ("nodes:\n\t- a", "2", "is not YAML"),
    ("noodes: []", "1: noodes", "unknown key 'noodes'; did you mean 'nodes'?"),
    ("nodes: 5", "1: nodes", "must be a list, not one value"),
    ("nodes:\n", "1: nodes", "must be a list, not empty"),
    ("nodes:\n  - simulator", "2: nodes[0]", "must be a mapping with 'node' or 'command'"),
    ("nodes:\n  - name: a", "2: nodes[0]", "needs either 'node'"),
    ("nodes:\n  - {node: a, command: b}", "2: nodes[0]", "needs either 'node'"),
    ("nodes:\n  - node: a\n    nmae: b", "3: nodes[0].nmae", "did you mean 'name'?"),
    ("nodes:\n  - node: a\n    node: b", "3: nodes[0].node", "written twice, first in line 2"),
    ("nodes:\n  - node: a\n    ? [x]\n    : 1", "3: nodes[0]", "a key must be a word"),
    ("nodes:\n  - node: a\n    name: a b", "3: nodes[0].name", "cannot be a node's name"),
    ("nodes:\n  - node: a\n    name: [x]", "3: nodes[0].name", "must be one value, not a list"),
    ("nodes:\n  - node: a\n    name:", "3: nodes[0].name", "has no value"),
    ("nodes:\n  - node: a\n    namespace: a//b", "3: nodes[0].namespace", "cannot be the name"),
    ("nodes:\n  - node: no.py", "2: nodes[0].node", "there is no file"),
    ("nodes:\n  - node: a\n    directory: no", "3: nodes[0].directory", "there is no folder"),
    ("nodes:\n  - command: []", "2: nodes[0].command", "is empty"),
    ("nodes:\n  - command: 'a \"b'", "2: nodes[0].command", "cannot be split into words"),
    ("nodes:\n  - command: '[ 1 ]'", "2: nodes[0].command", "give it a 'name'"),
    (
        "nodes:\n  - command: a\n    parameters: {x: 1}",
        "3: nodes[0].parameters",
        "is for tfbus nodes only",
    ),
    ("nodes:\n  - node: a\n    parameters: [x]", "3: nodes[0].parameters", "must be a mapping"),
    (
        "nodes:\n  - node: a\n    parameters:\n      x: {y: 1}",
        "4: nodes[0].parameters.x",
        "must be one value, not a mapping",
    ),
    (
        "nodes:\n  - node: a\n    remappings:\n      pose: /a//b",
        "4: nodes[0].remappings.pose",
        "cannot be the name of a topic",
    ),
    ("nodes:\n  - node: a\n    required: maybe", "3: nodes[0].required", "true or false"),
    ("nodes:\n  - node: a\n    respawn: 3", "3: nodes[0].respawn", "true or false"),
    (
        "nodes:\n  - node: a\n    respawn:\n      dely: 3",
        "4: nodes[0].respawn.dely",
        "did you mean 'delay'?",
    ),
    (
        "nodes:\n  - node: a\n    respawn:\n      delay: -1",
        "4: nodes[0].respawn.delay",
        "a number of seconds, 0 or more, not '-1'",
    ),
    (
        "nodes:\n  - node: a\n    respawn:\n      delay: nan",
        "4: nodes[0].respawn.delay",
        "a number of seconds",
    ),
    (
        "nodes:\n  - node: a\n    respawn:\n      limit: 1.5",
        "4: nodes[0].respawn.limit",
        "a whole number",
    ),
    ("nodes:\n  - node: a\n    if: perhaps", "3: nodes[0].if", "true or false, not 'perhaps'"),
    (
        "nodes:\n  - node: a\n    name: ${x}",
        "3: nodes[0].name",
        "no argument 'x' under 'arguments:'",
    ),
    (
        "arguments: {turtle: {default: a}}\nnodes:\n  - node: a\n    name: ${trutle}",
        "4: nodes[0].name",
        "did you mean 'turtle'?",
    ),
    ("nodes:\n  - node: a\n    name: ${HOME}", "3: nodes[0].name", "${env:HOME}"),
    ("nodes:\n  - node: a\n    name: ${env:NO}", "3: nodes[0].name", "'NO' is not set"),
    ("nodes:\n  - node: a\n    name: '${x'", "3: nodes[0].name", "without its '}'"),
    ("nodes:\n  - node: a\n  - node: a", "3: nodes[1]", "the name '/a' is taken by"),
    ("nodes:\n  - node: a\n    after: sim", "3: nodes[0].after", "no node 'sim' in this launch"),
    (
        "nodes:\n  - {node: a, name: simm}\n  - node: a\n    after:\n      - sim",
        "5: nodes[1].after[0]",
        "did you mean '/simm'?",
    ),
    ("nodes:\n  - node: a\n    after: a", "3: nodes[0].after", "would wait for itself"),
    (
        "nodes:\n  - {node: a, after: b}\n  - {node: b, after: a}",
        "2: nodes[0]",
        "waits for itself: /a after /b after /a",
    ),
    ("arguments: [a]\nnodes: []", "1: arguments", "must be a mapping"),
    ("arguments: {a b: }\nnodes: []", "1: arguments.a b", "cannot be the name of an argument"),
    ("arguments: {here: }\nnodes: []", "1: arguments.here", "the folder of the file"),
    ("arguments: {a: 5}\nnodes: []", "1: arguments.a", "must be a mapping, as in"),
    ("arguments:\n  a:\n    defualt: 5", "3: arguments.a.defualt", "did you mean 'default'?"),
    (
        "arguments:\n  a:\n    default: x\n    choices: [y, z]",
        "3: arguments.a.default",
        "'x' is not one of the choices y, z",
    ),
    ("includes:\n  - turtle", "2: includes[0]", "must be a mapping with 'file'"),
    ("includes:\n  - namespace: a", "2: includes[0]", "needs 'file'"),
    ("includes:\n  - file: ./no.yaml", "2: includes[0].file", "there is no launch file"),
    ("includes:\n  - file: trutle", "2: includes[0].file", "no launch file 'trutle'"),
    (
        "includes:\n  - file: robot.yaml",
        "2: includes[0].file",
        "includes itself: robot.yaml includes robot.yaml",
    ),
]


@pytest.mark.parametrize(("text", "where", "what"), MISTAKES)
def test_a_mistake_has_its_line_and_key(tmp_path: Path, text: str, where: str, what: str) -> None:
    """The error for any mistake in a launch file names file, line, key and cause."""
    with pytest.raises(YamlFileError) as caught:
        read(tmp_path, text)
    place, _, reason = str(caught.value).partition(f"robot.yaml:{where}: ")
    assert place == f"{tmp_path}/", f"wrong place: {caught.value}"
    assert what in reason


def test_files_that_include_each_other_many_times_are_a_mistake(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Sixty includes five deep would be 777 million files; 1,000 are read, and here 100."""
    assert reader.MOST_FILES == 1_000
    monkeypatch.setattr(reader, "MOST_FILES", 100)
    for depth in range(5):
        write(
            tmp_path, "includes: [" + f"{{file: ./{depth + 1}.yaml}}, " * 60 + "]", f"{depth}.yaml"
        )
    write(tmp_path, "nodes: [{node: sim}]", "5.yaml")
    with pytest.raises(YamlFileError, match=r"^[^ ]*\d\.yaml:1: includes.*at most 100 "):
        read_launch_file(tmp_path / "0.yaml")


def test_a_launch_has_a_limited_number_of_processes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Files that are included often may list many each: 10,000 are read, and here 100."""
    assert reader.MOST_PROCESSES == 10_000
    monkeypatch.setattr(reader, "MOST_PROCESSES", 100)
    nodes = "".join(f"- {{node: sim, name: s{n}}}\n" for n in range(20))
    write(tmp_path, f"nodes:\n{nodes}", "many.yaml")
    includes = [f"- {{file: ./many.yaml, namespace: n{n}}}\n" for n in range(6)]
    assert len(read(tmp_path, f"includes:\n{''.join(includes[:5])}")) == 100
    with pytest.raises(YamlFileError, match="at most 100 "):
        read(tmp_path, f"includes:\n{''.join(includes)}")


def test_an_argument_does_not_grow_without_end(tmp_path: Path) -> None:
    """Each file passes it on twice as long to the next."""
    for depth in range(40):
        arguments = "arguments: {a: {default: x}}"
        include = f"includes: [{{file: ./{depth + 1}.yaml, arguments: {{a: '${{a}}${{a}}'}}}}]"
        write(tmp_path, f"{arguments}\n{include}", f"{depth}.yaml")
    with pytest.raises(YamlFileError, match=r"arguments\.a: .*131,072 letters .*100,000"):
        read_launch_file(tmp_path / "0.yaml")


def test_what_is_nested_too_deeply_is_a_mistake(tmp_path: Path) -> None:
    """Not a RecursionError."""
    with pytest.raises(YamlFileError, match=r"robot\.yaml:1: .*nested"):
        read(tmp_path, "[" * 600)


def test_a_long_chain_of_nodes_that_wait_is_read(tmp_path: Path) -> None:
    """Each after the one before."""
    nodes = [f"- {{node: sim, name: n{n}, after: [n{n - 1}]}}\n" for n in range(1, 1_100)]
    assert len(read(tmp_path, "nodes:\n- {node: sim, name: n0}\n" + "".join(nodes))) == 1_100


def test_a_circle_of_includes_names_its_files(tmp_path: Path) -> None:
    """The error names the files of the circle in order."""
    write(tmp_path, "includes:\n  - file: ./b.yaml\n", "a.yaml")
    write(tmp_path, "includes:\n  - file: ./robot.yaml\n", "b.yaml")
    with pytest.raises(YamlFileError, match=r"b\.yaml:2: .* itself: .*robot\.yaml$"):
        read(tmp_path, "includes:\n  - file: ./a.yaml\n")


@pytest.mark.parametrize(
    ("arguments", "where", "what"),
    [
        ("{}", 3, "needs a value for its argument 'turtle'"),
        ("\n      trutle: a", 4, "takes no argument 'trutle'; did you mean 'turtle'?"),
        ("\n      turtle: c", 4, "must be one of a, b, not 'c'"),
    ],
)
def test_an_include_with_wrong_arguments_is_a_mistake_of_the_file_that_includes(
    tmp_path: Path, arguments: str, where: int, what: str
) -> None:
    """Arguments of an include are checked like those of the command line, with their line."""
    write(tmp_path, "arguments: {turtle: {choices: [a, b]}}\nnodes: [{node: a}]", "one.yaml")
    text = f"includes:\n  - file: ./one.yaml\n    arguments: {arguments}\n"
    with pytest.raises(YamlFileError) as caught:
        read(tmp_path, text)
    assert f"robot.yaml:{where}: includes[0].arguments" in str(caught.value)
    assert what in str(caught.value)


def test_a_mistake_in_an_included_file_names_that_file(tmp_path: Path) -> None:
    """The line of a mistake is that of the included file."""
    write(tmp_path, "\n\nnodes:\n  - nod: a\n", "one.yaml")
    with pytest.raises(YamlFileError, match=r"one\.yaml:4: nodes\[0\]\.nod: "):
        read(tmp_path, "includes:\n  - file: one.yaml\n")


def test_a_file_that_cannot_be_read_is_an_error_in_a_sentence(tmp_path: Path) -> None:
    """A file that is not text, or does not exist, is an error in a sentence."""
    (tmp_path / "binary.yaml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(YamlFileError, match="not a text"):
        read_launch_file(tmp_path / "binary.yaml")
    with pytest.raises(YamlFileError, match="cannot be read: No"):
        read_launch_file(tmp_path / "nowhere.yaml")


@given(st.text(max_size=200))
def test_any_text_is_read_or_refused_in_a_sentence(
    tmp_path_factory: pytest.TempPathFactory, text: str
) -> None:
    """Any text is read, or raises an error of tfbus."""
    path = tmp_path_factory.getbasetemp() / "any.yaml"
    path.write_bytes(text.encode(errors="surrogatepass"))
    try:
        read_launch_file(path)
    except TfbusError as error:
        assert str(error)


# -- arguments on the command line

ARGUMENTS = """
    arguments:
      turtle: {description: whose frames}
      style: {default: foxy, choices: [foxy, newest]}
    nodes:
      - {node: echo, arguments: ["${turtle}", "${style}"]}
"""


def test_arguments_are_given_or_have_a_default(tmp_path: Path) -> None:
    """An argument has the value given, or else its default."""
    assert read(tmp_path, ARGUMENTS, turtle="bob")[0].arguments == ("bob", "foxy")
    assert read(tmp_path, ARGUMENTS, turtle="", style="newest")[0].arguments == ("", "newest")


@pytest.mark.parametrize(
    ("given", "what"),
    [
        ({}, "needs a value for its argument 'turtle' (whose frames)"),
        ({"turtle": "a", "stile": "x"}, "no argument 'stile'; did you mean 'style'?"),
        ({"turtle": "a", "style": "x"}, "must be one of foxy, newest, not 'x'"),
    ],
)
def test_wrong_arguments_are_refused(tmp_path: Path, given: dict[str, str], what: str) -> None:
    """The error for an unknown, missing or invalid argument says what is allowed."""
    with pytest.raises(LaunchArgumentError) as caught:
        read(tmp_path, ARGUMENTS, **given)
    assert what in str(caught.value)


def test_arguments_are_shown_as_ros2_launch_shows_them(tmp_path: Path) -> None:
    """`--show-args` lists every argument with description, choices and default."""
    arguments = read_arguments(write(tmp_path, ARGUMENTS))
    assert arguments == (
        Argument("turtle", description="whose frames"),
        Argument("style", default="foxy", choices=("foxy", "newest")),
    )
    assert show_arguments(arguments).splitlines() == [
        "Arguments (pass arguments as '<name>:=<value>'):",
        "",
        "    'turtle':",
        "        whose frames",
        "",
        "    'style':",
        "        no description",
        "        one of: foxy, newest",
        "        (default: 'foxy')",
    ]


# -- finding files


def test_a_launch_file_is_found_by_name_or_path(tmp_path: Path) -> None:
    """A word is the name of an installed file; with a slash or `.yaml` it is a path."""
    path = write(tmp_path, "", "mine.yaml")
    assert find_launch_file(str(path)) == path
    assert find_launch_file("mine.yaml", tmp_path) == path
    assert find_launch_file("turtle") == installed_launch_files()["turtle"]


def test_an_unknown_name_is_answered_with_a_near_one_or_all(tmp_path: Path) -> None:
    """The error for an unknown name has the nearest name, or all names."""
    write(tmp_path, "", "mine.yaml")
    with pytest.raises(LaunchError, match=r"; did you mean 'turtle'\?"):
        find_launch_file("turtel")
    with pytest.raises(LaunchError, match=r"; available: carrot, .*turtle"):
        find_launch_file("xyz")
    with pytest.raises(LaunchError, match=r" mean '\./mine\.yaml'\?"):
        find_launch_file("mine", tmp_path)


@pytest.mark.parametrize("name", sorted(installed_launch_files()))
def test_every_installed_launch_file_can_be_started(name: str) -> None:
    """All launch files of tfbus are valid, and start existing nodes."""
    from tfbus.cli import NODES

    processes = read_launch_file(find_launch_file(name))
    for process in processes:
        check_startable(process, NODES)


# -- command lines


def program_line(process: DescribedProcess, **settings: object) -> tuple[str, ...]:
    return program_of(process, NodeSettings("launch", **settings)).argv[1:]  # tests only


def test_a_node_is_started_with_its_names_and_the_options_of_launch(tmp_path: Path) -> None:
    """Nodes join the bus as launch does, but do not listen where it does."""
    [process] = read(
        tmp_path,
        """
        nodes:
          - node: broadcaster
            namespace: robot7
            parameters: {turtlename: turtle1}
            remappings: {pose: p}
            arguments: [--x]
        """,
    )
    line = program_line(
        process, mode="client", connect=("tcp/a:1",), listen=("tcp/b:2",), sim_time=True
    )
    assert " ".join(line) == (
        "-P -m tfbus broadcaster --name broadcaster --namespace robot7 --mode client "
        "--connect tcp/a:1 --sim-time --param turtlename=turtle1 --remap pose:=p --x"
    )


def test_a_command_learns_about_the_bus_from_its_environment(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A program of one's own gets launch's settings as variables, and its own variables last."""
    for name in [name for name in os.environ if name.startswith("TFBUS")]:
        monkeypatch.delenv(name)
    [process] = read(
        tmp_path, "nodes:\n  - {command: [env], namespace: a, environment: {TFBUS_MODE: peer}}"
    )
    settings = NodeSettings("launch", mode="client", connect=("tcp/a:1",), sim_time=True)
    program = program_of(process, settings)
    assert program.argv == ("env",)
    assert {k: v for k, v in program.environment.items() if k.startswith("TFBUS")} == {
        "TFBUS_NAMESPACE": "a",
        "TFBUS_MODE": "peer",
        "TFBUS_CONNECT": "tcp/a:1",
        "TFBUS_LOG_LEVEL": "info",
        "TFBUS_SIM_TIME": "1",
    }


def test_options_of_launch_win_over_its_environment(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A variable of launch's environment does not reach a node if an option of launch differs."""
    for name in [name for name in os.environ if name.startswith("TFBUS")]:
        monkeypatch.delenv(name)
    monkeypatch.setenv("TFBUS_LOG_LEVEL", "debug")
    monkeypatch.setenv("TFBUS_NAMESPACE", "robot7")
    monkeypatch.setenv("TFBUS_MODE", "client")
    [plain, own] = read(
        tmp_path,
        """
        nodes:
          - node: simulator
          - {node: clock, environment: {TFBUS_LOG_LEVEL: warning}}
        """,
    )
    settings = NodeSettings("launch", namespace="", log_level="info")
    program = program_of(plain, settings)
    assert {k: v for k, v in program.environment.items() if k.startswith("TFBUS")} == {
        "TFBUS_LOG_LEVEL": "info",
        "TFBUS_MODE": "client",
    }
    assert "env -u TFBUS_NAMESPACE PYTHONUNBUFFERED=1 " in dry_run_line(program)
    assert program_of(own, settings).environment["TFBUS_LOG_LEVEL"] == "warning"


def test_a_file_may_say_that_time_is_simulated(tmp_path: Path) -> None:
    """`sim_time` of a file holds for all its nodes and those of its includes."""
    (tmp_path / "inner.yaml").write_text("nodes:\n  - {node: simulator, name: sim}\n")
    inner, outer, command = read(
        tmp_path,
        """
        arguments: {sim: {default: "yes"}}
        sim_time: ${sim}
        includes: [{file: ./inner.yaml}]
        nodes:
          - node: broadcaster
          - command: [env]
        """,
    )
    assert "--sim-time" in program_line(inner)
    assert "--sim-time" in program_line(outer)
    assert program_of(command, NodeSettings("launch")).environment["TFBUS_SIM_TIME"] == "1"


def test_a_dry_run_prints_what_a_shell_would_do_alike(tmp_path: Path) -> None:
    """Each line of a dry run is the name and a command to paste."""
    (tmp_path / "a b").mkdir()
    text = "nodes:\n  - {command: [echo, $HOME], environment: {A: b c}, directory: a b}"
    [process] = read(tmp_path, text)
    assert dry_run_line(program_of(process, NodeSettings("launch"))) == (
        f"[echo] cd '{tmp_path.resolve()}/a b' && "
        "env PYTHONUNBUFFERED=1 TFBUS_LOG_LEVEL=info 'A=b c' echo '$HOME'"
    )


@pytest.mark.parametrize(
    ("entry", "what"),
    [
        ("node: simulatro", "(a file of your own ends with .py); did you mean 'simulator'?"),
        ("command: no-such-program-here", "no executable program 'no-such-program-here'"),
        ("command: ./robot.yaml", "no executable program './robot.yaml'"),
    ],
)
def test_a_missing_program_is_an_error_before_anything_starts(
    tmp_path: Path, entry: str, what: str
) -> None:
    """All programs are looked up first, so no launch stops half way."""
    [process] = read(tmp_path, f"nodes:\n  - {entry}\n    name: a\n    directory: .\n")
    with pytest.raises(YamlFileError) as caught:
        check_startable(process, {"simulator"})
    assert "robot.yaml:2: nodes[0]: " in str(caught.value) and what in str(caught.value)


# -- the page about it

PAGE = Path(__file__).parents[2] / "docs" / "guide" / "launch.md"


def test_the_example_of_the_documentation_can_be_started(tmp_path: Path) -> None:
    """The launch file shown in docs/guide/launch.md means what it says there."""
    example = PAGE.read_text().split("```yaml\n")[1].split("```")[0]
    sim, broadcaster, echo = read(tmp_path, example)
    assert (sim.name, broadcaster.respawn, echo.after) == ("sim", Respawn(), ("/sim",))
    assert echo.arguments == ("world", "drone", "--rate", "2")


@pytest.mark.parametrize(
    ("title", "mistake"),
    [
        ("key of the file", "x: 1"),
        ("key of an argument", "arguments: {a: {x: 1}}"),
        ("key of an include", "includes: [{x: 1}]"),
        ("key of a node", "nodes: [{x: 1}]"),
    ],
)
def test_the_documentation_knows_every_key(tmp_path: Path, title: str, mistake: str) -> None:
    """The tables of keys in docs/guide/launch.md are those that the reader knows."""
    table = PAGE.read_text().split(f"| {title} |")[1].split("\n\n")[0]
    documented = [key for row in re.findall(r"^\| (`.*?) \|", table, re.M) for key in split(row)]
    with pytest.raises(YamlFileError) as caught:
        read(tmp_path, mistake)
    known = str(caught.value).split("; available: ")[1].split(", ")
    assert sorted(documented) == sorted(known)


def split(row: str) -> list[str]:
    return re.findall(r"`(\w+)`", row)
