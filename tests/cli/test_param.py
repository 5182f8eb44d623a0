"""`tfbus param` and `tfbus service`: many at once, files, descriptions, and types."""

import json
from pathlib import Path

import pytest

from tests.simulated_bus import Bus
from tfbus import Node
from tfbus.messages import Spawn


def run(bus: Bus, *arguments: str, stdin: str = "") -> tuple[int, str, str]:
    """Exit code, stdout and the last line of stderr of `tfbus ARGUMENTS`."""
    done = bus.run(*arguments, stdin=stdin)
    assert "Traceback" not in done.stdout + done.stderr
    return done.returncode, done.stdout, (done.stderr.splitlines() or [""])[-1]


@pytest.fixture
def sim(bus: Bus) -> Node:
    """A node with three parameters and a service."""
    node = bus.node("sim")
    node.declare_parameter("red", 69, minimum=0, maximum=255, description="How red it is.")
    node.declare_parameter("rates", [1.0, 2.5])
    node.declare_parameter("title", "100")
    node.create_service(Spawn, "spawn", lambda request: Spawn.Response(request.name))
    return node


class TestParameters:
    def test_names_are_listed_with_types_by_a_filter_or_as_json(self, bus: Bus, sim: Node) -> None:
        """A list has the names under their node; --filter takes those that have it in them."""
        assert run(bus, "param", "list", "-t", "--filter", "^r") == (
            0,
            "/sim:\n  rates [list]\n  red [integer]\n",
            "",
        )
        _, out, _ = run(bus, "param", "list", "sim", "--json")
        assert json.loads(out) == {"/sim": ["rates", "red", "title"]}
        assert run(bus, "param", "list", "--filter", "(")[0] == 2

    def test_several_are_read_and_set_at_once(self, bus: Bus, sim: Node) -> None:
        """Parameters are set in pairs of name and value, and read by their names."""
        done = run(bus, "param", "set", "sim", "red", "7", "rates", "[3]")
        assert done == (0, "Set parameter successful: red\nSet parameter successful: rates\n", "")
        assert run(bus, "param", "get", "sim", "red", "rates") == (
            0,
            "red: Integer value is: 7\nrates: List value is: [3]\n",
            "",
        )
        assert run(bus, "param", "get", "sim", "red", "--hide-type")[1] == "7\n"
        assert run(bus, "param", "get", "sim", "red", "title", "--json")[1] == (
            '{"red": 7, "title": "100"}\n'
        )
        code, _, sentence = run(bus, "param", "set", "sim", "red", "7", "rates")
        assert (code, sentence.startswith("Error: ")) == (2, True)
        assert "'rates' has no value" in sentence

    def test_a_negative_number_is_a_value(self, bus: Bus, sim: Node) -> None:
        """A negative number needs no `--` before it; an unknown option is an error."""
        rate = sim.declare_parameter("rate", 1.0)
        done = run(bus, "param", "set", "sim", "rate", "-1.5", "--log-level", "error")
        assert done == (0, "Set parameter successful\n", "")
        assert rate.value == -1.5
        code, _, sentence = run(bus, "param", "set", "sim", "rate", "-1", "--nonsense")
        assert code == 2 and sentence.startswith("Error: ") and "'--nonsense'" in sentence

    def test_what_is_dumped_can_be_loaded(self, bus: Bus, sim: Node, tmp_path: Path) -> None:
        """A dump is YAML by the node's name, and sets the same again, texts as texts."""
        _, dump, _ = run(bus, "param", "dump", "sim")
        assert dump == "/sim:\n  rates:\n  - 1.0\n  - 2.5\n  red: 69\n  title: '100'\n"
        file = tmp_path / "sim.yaml"
        file.write_text(dump.replace("69", "70"))
        code, out, _ = run(bus, "param", "load", "sim", str(file))
        assert (code, out.splitlines()) == (
            0,
            [f"Set parameter {name} successful" for name in ("rates", "red", "title")],
        )
        values = json.loads(run(bus, "param", "dump", "sim", "--json")[1])
        assert values == {"/sim": {"rates": [1.0, 2.5], "red": 70, "title": "100"}}

    @pytest.mark.parametrize(
        "text",
        ["{red: 1}", "{sim: {red: 1}}", "{/**: {ros__parameters: {red: 1}}, /other: {red: 2}}"],
    )
    def test_a_file_may_be_for_any_node(self, bus: Bus, sim: Node, text: str) -> None:
        """Parameters alone, under a node, or under ROS 2's headings are all read."""
        done = run(bus, "param", "load", "sim", "-", stdin=text)
        assert done == (0, "Set parameter red successful\n", "")

    def test_refused_parameters_are_printed_and_the_rest_set(self, bus: Bus, sim: Node) -> None:
        """An invalid value does not keep the others from being set; the exit code is 1."""
        done = run(bus, "param", "load", "sim", "-", stdin="{red: 300, title: hello}")
        assert done[:2] == (1, "Set parameter title successful\n")
        assert done[2].startswith("Error: 1 of 2 parameters")

    @pytest.mark.parametrize(
        ("text", "sentence"),
        [
            ("[1]", "<stdin> is not a YAML map of parameters"),
            ("{/other: {red: 1}}", "<stdin> has no parameters for /sim; available: /other"),
        ],
    )
    def test_a_file_that_is_none_is_a_usage_error(
        self, bus: Bus, sim: Node, text: str, sentence: str
    ) -> None:
        """A file that is not a map, or has nothing for the node, is an error; nothing is set."""
        code, out, report = run(bus, "param", "load", "sim", "-", stdin=text)
        assert (code, out, report.startswith("Error: ")) == (2, "", True)
        assert report.endswith(f" FILE: {sentence}")

    def test_a_file_that_is_no_text_is_a_usage_error(
        self, bus: Bus, sim: Node, tmp_path: Path
    ) -> None:
        """A binary file is refused in one sentence."""
        file = tmp_path / "sim.mcap"
        file.write_bytes(b"\x89MCAP0\r\n")
        code, out, report = run(bus, "param", "load", "sim", str(file))
        assert (code, out) == (2, "")
        assert report.endswith("sim.mcap is not a text file in UTF-8")

    def test_parameters_are_described(self, bus: Bus, sim: Node) -> None:
        """A description has the type, what it is for, and the bounds."""
        assert run(bus, "param", "describe", "sim", "red")[1].splitlines() == [
            "Parameter name: red",
            "  Type: integer",
            "  Description: How red it is.",
            "  Constraints:",
            "    Min value: 0",
            "    Max value: 255",
        ]
        described = json.loads(run(bus, "param", "describe", "sim", "--json")[1])
        assert [(each["name"], each["type"]) for each in described] == [
            ("rates", "list"),
            ("red", "integer"),
            ("title", "text"),
        ]


class TestServices:
    def test_services_are_listed(self, bus: Bus, sim: Node) -> None:
        """Services are listed by name, with their types, counted, or as JSON."""
        bus.node("robot7", namespace="robot7").create_client(Spawn, "spawn")
        assert run(bus, "service", "list") == (0, "spawn\n", "")
        assert run(bus, "service", "list", "-t")[1] == "spawn [Spawn]\n"
        assert run(bus, "service", "list", "-c")[1] == "1\n"
        (listed,) = json.loads(run(bus, "service", "list", "--json")[1])
        assert (listed["name"], listed["servers"][0]["node"]) == ("spawn", "/sim")
        _, out, _ = run(bus, "service", "info", "robot7/spawn")
        assert out.splitlines() == ["Type: Spawn", "Clients count: 1", "Services count: 0"]
        _, _, err = run(bus, "service", "info", "spwan")
        assert "no service 'spwan'" in err and "mean 'spawn'" in err

    def test_a_response_is_printed_as_yaml(self, bus: Bus, sim: Node) -> None:
        """A call prints the response; its type may be given, and is checked."""
        request = "{x: 2, y: 3, name: turtle2}"
        assert run(bus, "service", "call", "spawn", request) == (0, "name: turtle2\n", "")
        assert run(bus, "service", "call", "spawn", "Spawn", request, "--json") == (
            0,
            '{"name": "turtle2"}\n',
            "",
        )
        code, out, report = run(bus, "service", "call", "spawn", "Kill", request)
        assert (code, out, report.startswith("Error: 'spawn' ")) == (2, "", True)
        assert report.endswith("type Spawn, not Kill")

    def test_a_missing_service_ends_with_1_and_an_unknown_field_with_2(
        self, bus: Bus, sim: Node
    ) -> None:
        """Fields are checked before the request is sent."""
        code, _, report = run(bus, "service", "call", "spawn", "{z: 1}")
        assert code == 2 and report.startswith("Error: ") and "no field 'z'; " in report
        code, out, report = run(bus, "service", "call", "spwan")
        assert (code, out) == (1, "")
        assert "no service 'spwan'" in report and "mean 'spawn'" in report
