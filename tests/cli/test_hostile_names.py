"""A stranger on the bus with hostile texts: no tool lets them reach a terminal or a file raw."""

import json
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast

import pytest
import yaml

from tests.builders import at, payload
from tests.buses import send_static
from tests.simulated_bus import Bus
from tfbus.bus.query import Query
from tfbus.bus.retained import declare_retained_publisher
from tfbus.wire.codec import encode_map
from tfbus.wire.keys import (
    node_key,
    node_parameters_key,
    static_transforms_key,
    stream_key,
)

FORGED = "[INFO] [1795252263.740641361] [sim]: all is well"
HOSTILE = (
    "\x1b[2J\x1b[31mred\x1b]0;title\x07\r\n"
    f"{FORGED}\n\x9b5m\u202egnp.exe\u2066\x85\u2028<script>\"'`$(touch owned)`]]>&#35;{{}}"
)
LONG = HOSTILE + "\N{TURTLE}" * 10_000


@pytest.fixture
def stranger(bus: Bus) -> Iterator[Bus]:
    """A bus on which world -> turtle1 is honest, and a stranger is beside it."""
    send_static(bus.node("honest"), "world", "turtle1")
    session = bus.node("stranger").session
    described = {
        "name": "/liar",
        "host": LONG,
        "pid": 1,
        "version": HOSTILE,
        "session": "abc",
        "started_ns": 1,
        "streams": [HOSTILE],
        "parameters": [
            {"name": HOSTILE, "value": LONG, "type": HOSTILE, "description": LONG, "minimum": 1}
        ],
        "publishes": {"chat": HOSTILE, HOSTILE: HOSTILE},
        "subscribes": {LONG: LONG},
        "serves": {"ask": HOSTILE},
        "calls": {HOSTILE: HOSTILE},
        "unread": [HOSTILE],
    }

    def describe(query: Query) -> None:
        query.answer(query.key, encode_map(described))
        query.close()

    def parameter(query: Query) -> None:
        [hostile] = cast(list[dict[str, Any]], described["parameters"])
        query.answer(query.key.replace("*", "p"), encode_map(hostile))
        query.close()

    def refuse(query: Query) -> None:
        query.refuse(LONG)
        query.close()

    for name in ("liar", HOSTILE):
        session.token(node_key(name))
        session.queryable(node_key(name), describe)
    session.queryable(node_parameters_key("liar"), parameter)
    session.queryable("ask", refuse)
    session.token(stream_key(HOSTILE))
    rows = [("world", "trap", True), ("world", HOSTILE, True)]
    stream = {"v": 1, "node": HOSTILE, "epoch": 1, "frames": rows, "host": LONG, "pid": 1}
    retained = [
        declare_retained_publisher(session, key(HOSTILE))
        for key in (stream_key, static_transforms_key)
    ]
    for publisher, content in zip(
        retained, (encode_map(stream), payload([at(1.0, "trap")])), strict=True
    ):
        publisher.put(content)
    chat = bus.node("chatter").create_raw_publisher("chat", type_name="Chat")
    message = encode_map({"text": HOSTILE, HOSTILE: [HOSTILE, HOSTILE.encode()]})
    bus.node("repeater").create_timer(0.1, lambda: chat.publish(message))
    yield bus
    for publisher in retained:
        publisher.close()


def assert_harmless(text: str) -> None:
    """Nothing in the text moves a cursor, turns letters round, or stands on a line of its own."""
    assert {letter for letter in text if not letter.isprintable()} <= {"\n", "\t"}
    assert not [line for line in text.splitlines() if line.startswith(FORGED)]
    assert "\N{TURTLE}" * 3000 not in text, "it is not cut"


LINES = [
    "frames",
    "frames --long",
    "frames --json",
    "node list",
    "node info /liar",
    "node info liarr",
    "topic list -t",
    "topic list -v",
    "topic info chat -v",
    "topic echo chat --once",
    "topic echo chat --once --csv",
    "topic echo chat --once --json",
    "topic echo chat --once --field text",
    "topic echo chat --once --field nothing",
    "topic find nothing",
    "service list -t",
    "service call ask",
    "service type ask",
    "call ask",
    "param list",
    "param list /liar --param-type",
    "param describe /liar p",
    "doctor --for 0.5",
    "monitor --once",
    "monitor world turtle1 --once",
    "why world turtle1",
    "why world turtle2",
    "echo world turtle1 --once",
    "echo world turtle2 --timeout 0.5",
]


@pytest.mark.parametrize("line", LINES)
def test_no_tool_prints_it_raw(stranger: Bus, line: str) -> None:
    """What a stranger calls itself comes escaped and cut, in output and in errors."""
    done = stranger.run(*line.split())
    assert_harmless(done.stdout + done.stderr)
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize("line", ["param get /liar p", "param dump /liar"])
def test_a_value_is_whole_and_escaped(stranger: Bus, line: str) -> None:
    """What a tool is asked for comes in full, in one line that can be printed."""
    shown = stranger.run(*line.split()).stdout
    assert_harmless(shown.replace("\N{TURTLE}" * 10_000, "").replace(r"\U0001F422" * 10_000, ""))


def test_files_stay_what_they_are(stranger: Bus, tmp_path: Path) -> None:
    """Pictures and documents are of their format, and hold no control character."""
    files = {ending: tmp_path / f"it.{ending}" for ending in ("svg", "yaml", "json", "dot", "mmd")}
    done = stranger.run("frames", *[word for file in files.values() for word in ("-o", str(file))])
    assert done.returncode == 0, done.stderr
    for file in files.values():
        assert_harmless(file.read_text().replace("\r", ""))
    ElementTree.parse(files["svg"])
    assert yaml.safe_load(files["yaml"].read_text()).keys() >= {"turtle1"}
    assert json.loads(files["json"].read_text())["roots"] == ["world"]


def test_a_terminal_gets_only_our_own_styles(stranger: Bus) -> None:
    """In a terminal the only escape sequences are those of colours that the tool itself chose."""
    for line in ("node info /liar", "param describe /liar p", "topic info chat -v"):
        shown = stranger.run_in_terminal(*line.split())
        assert "red" in shown and "\x1b[31m" not in shown
        for style in ("0", "1", "2", "32", "33", "36"):
            shown = shown.replace(f"\x1b[{style}m", "")
        assert_harmless(shown.replace("\r\n", "\n"))
