"""`tfbus foxglove` as a process, with the turtles of the demo."""

import json
import re
import ssl
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("websockets", reason="needs websockets: pip install websockets")
from websockets.exceptions import InvalidStatus

from tests import needs
from tests.buses import DEADLINE_S, eventually, send_until
from tests.foxglove.client import Client
from tests.live_bus import Bus, Process, free_port
from tests.recordings import publisher, statics, write
from tests.simulated_bus import Bus as SimulatedBus
from tfbus import TransformStamped
from tfbus.ros.tf_message import TFMessageReader


def foxglove(bus: Bus, *arguments: str) -> tuple[Process, int]:
    """The bridge, and its port once it listens."""
    process = bus.start("foxglove", "--port", str(free_port()), *arguments)
    line = process.wait_for_line("Foxglove: open https://app.foxglove.dev/")
    return process, int(line.rpartition(":")[2])


def transforms_of(client: Client, child: str) -> list[TransformStamped]:
    """All transforms of a frame that came."""
    found = [each for data in client.of("/tf") for each in TFMessageReader().read(data)]
    return [each for each in found if each.child_frame_id == child]


@pytest.mark.real
def test_the_demo_in_foxglove(bus: Bus) -> None:
    """Its frames follow the turtle, which the teleop panel drives; parameters, services and the
    graph are there; a late client has the static frames.
    """
    bus.start("simulator").wait_for_line("ready")
    bus.start("broadcaster")
    bus.start("static", "world", "lamp", "--x", "1.5").wait_for_line("ready")
    process, port = foxglove(bus, "--teleop", "turtle1/cmd_vel")
    with Client(port) as client:
        client.subscribe("/tf")
        client.send("subscribeConnectionGraph")
        eventually(lambda: transforms_of(client, "turtle1"))
        start = transforms_of(client, "turtle1")[-1].transform.x
        client.advertise("/cmd_vel", "geometry_msgs/Twist")
        send_until(
            lambda: client.publish(b'{"linear": {"x": 2.0}}'),
            lambda: transforms_of(client, "turtle1")[-1].transform.x > start + 0.5,
        )
        eventually(lambda: client.published.get("/turtle1/pose") == ["/sim"])
        eventually(lambda: client.published.get("/tf") == ["/broadcaster1"])
        client.send("getParameters", parameterNames=["/sim.background_r"], id="r")
        eventually(lambda: client.parameters.get("/sim.background_r") == 69)

        def is_set() -> bool:
            given = [{"name": "/sim.background_r", "value": 100}]
            client.send("setParameters", parameters=given, id="s")
            return client.parameters["/sim.background_r"] == 100

        # Again: on a busy machine the node may not answer in time.
        eventually(is_set, every_s=1.0)
        get = ("param", "get", "sim", "background_r", "--hide-type")
        eventually(lambda: bus.run(*get).stdout == "100\n")
        assert client.call("/spawn", {"x": 2.0, "y": 3.0, "name": "late"}) == {"name": "late"}
        client.subscribe("/late/pose")
    with Client(port) as late:
        late.subscribe("/tf_static")
        eventually(lambda: late.of("/tf_static"))
        [lamp] = TFMessageReader().read(late.of("/tf_static")[0])
        assert (lamp.frame_id, lamp.child_frame_id, lamp.transform.x) == ("world", "lamp", 1.5)
    assert process.stop() == 0
    assert process.out == []


@pytest.mark.real
def test_a_recording_needs_no_bus(bus: Bus, tmp_path: Path) -> None:
    """It is played with neither the bus of the user nor another; Ctrl-C ends it with 0."""
    path = write(tmp_path / "run.mcap", statics(publisher("lamp"), 0.0, ("world", "lamp", 1.5)))
    process = Process(
        [sys.executable, "-m", "tfbus", "foxglove", "--bag", str(path), "--port", str(free_port())],
        {**bus.env, "TFBUS_CONNECT": "tcp/127.0.0.1:1", "TFBUS_MODE": "client"},
    )
    try:
        line = process.wait_for_line("Foxglove: open https://")
        with Client(int(line.rpartition(":")[2])) as client:
            client.subscribe("/tf_static")
            eventually(lambda: client.of("/tf_static"))
            assert process.stop() == 0
        assert process.err == [line]
    finally:
        process.kill()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--port", "http"), "'http' is not a port number from 1 to 65535"),
        (("--rate", "2"), "--rate and --loop play a recording: give --bag"),
        (("--read-only", "--teleop", "cmd_vel"), "--read-only and --teleop are mutually exclusive"),
        (("--shared", "map"), "--shared needs --fleet"),
        (("--bag", "nothing.mcap"), "'nothing.mcap' does not exist"),
    ],
)
def test_mistakes_are_usage_errors(
    bus: SimulatedBus, arguments: tuple[str, ...], said: str
) -> None:
    """In one sentence, with exit code 2."""
    done = bus.run("foxglove", *arguments)
    assert done.returncode == 2 and said in done.stderr


def test_what_is_no_recording_ends_in_one_sentence(bus: SimulatedBus, tmp_path: Path) -> None:
    """With exit code 1."""
    path = tmp_path / "run.mcap"
    path.write_text("no recording")
    done = bus.run("foxglove", "--bag", str(path))
    assert done.returncode == 1
    assert done.stderr.startswith("Error: ") and len(done.stderr.splitlines()) == 1


# Foxglove's own libraries, as its application uses them: the client, and the reader of messages.
_SCRIPT = """
const { FoxgloveClient } = require("@foxglove/ws-protocol");
const { parse } = require("@foxglove/rosmsg");
const { MessageReader } = require("@foxglove/rosmsg2-serialization");
const socket = new (require("ws"))(process.argv[1], ["foxglove.sdk.v1"]);
const client = new FoxgloveClient({ ws: socket });
const readers = new Map();
client.on("advertise", (channels) => {
  for (const { id, topic, schema } of channels) {
    if (topic !== "/tf_static") continue;
    readers.set(client.subscribe(id), new MessageReader(parse(schema, { ros2: true })));
  }
});
client.on("message", ({ subscriptionId, data }) => {
  console.log(JSON.stringify(readers.get(subscriptionId).readMessage(data).transforms[0]));
  process.exit(0);
});
"""
_LIBRARIES = ("@foxglove/ws-protocol", "@foxglove/rosmsg", "@foxglove/rosmsg2-serialization", "ws")


@pytest.mark.real
def test_foxgloves_own_libraries_read_it(bus: Bus) -> None:
    """The libraries are those of npm, where node finds them (NODE_PATH)."""
    node = needs.program("node")
    for library in _LIBRARIES:
        if subprocess.run([node, "-e", f"require('{library}')"], capture_output=True).returncode:
            needs.skip(library, f"npm install {library}")
    bus.start("static", "world", "lamp", "--x", "1.5").wait_for_line("ready")
    _, port = foxglove(bus)
    done = subprocess.run(
        [node, "-e", _SCRIPT, f"ws://127.0.0.1:{port}"],
        capture_output=True,
        text=True,
        timeout=DEADLINE_S,
    )
    assert done.stdout, done.stderr
    seen = json.loads(done.stdout)
    assert (seen["header"]["frame_id"], seen["child_frame_id"]) == ("world", "lamp")
    assert seen["transform"]["translation"] == {"x": 1.5, "y": 0, "z": 0}


@pytest.mark.real
def test_others_reach_it_by_a_token_only(bus: Bus) -> None:
    """And only look, unless --operate lets them do more."""
    done = bus.run("foxglove", "--host", "0.0.0.0")
    assert done.returncode == 2 and "add --public" in done.stderr
    done = bus.run("foxglove", "--public", "--teleop", "turtle1/cmd_vel")
    assert done.returncode == 2 and "add --operate for --teleop" in done.stderr
    needs.module("cryptography")
    process = bus.start("foxglove", "--public", "--port", str(free_port()))
    line = process.wait_for_line("Foxglove: connect to wss://")
    port, query = re.findall(r":(\d+)(/[^ ]*)", line)[0]
    context = ssl.create_default_context()
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    with pytest.raises(InvalidStatus, match="401"):
        Client(int(port), ssl=context)
    with Client(int(port), query=query, ssl=context) as client:
        info = eventually(lambda: client.texts_of("serverInfo"))[0]
        assert not {"services", "clientPublish"} & set(info["capabilities"])
