"""Static transforms in recordings: they hold at all times, or from when they were received."""

import sys
from pathlib import Path
from types import FrameType
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import tfbus
from tests.builders import examples
from tests.recordings import T0, at, described, publisher, sent, statics, write
from tfbus import Buffer
from tfbus.bus.settings import NodeSettings
from tfbus.command.recordings import BagChoice
from tfbus.command.types import Moment
from tfbus.frames.recorded_poses import recorded_transform
from tfbus.recording.items import Item
from tfbus.recording.reader import RecordingReader
from tfbus.recording.state import LastingStatics, Statics
from tfbus.recording.writer import RecordingWriter

SETTINGS = NodeSettings("test")
MODEL, ARM, SIM = publisher("model"), publisher("arm"), publisher("sim")


def answer(source: Buffer | tfbus.Recording, target: str, frame: str, stamp_ns: int) -> object:
    """The pose, or the class of the error."""
    try:
        return source.lookup_transform(target, frame, stamp_ns).transform.as_pose()
    except tfbus.TransformException as error:
        return type(error)


@st.composite
def recordings(draw: st.DrawFn) -> list[Item]:
    """A robot that moves for 10 s, whose static frames are told at any times: in one stream one
    after the other, as ROS has them, or by several streams.
    """
    items: list[Item] = [sent(SIM, second / 2, ("map", "base", second)) for second in range(20)]
    names = draw(st.permutations(["laser", "mast", "camera", "tool"]))
    parents = ["base", *names]
    streams = draw(st.lists(st.sampled_from([MODEL, ARM]), min_size=4, max_size=4))
    seconds = sorted(draw(st.lists(st.integers(0, 90), min_size=4, max_size=4)))
    edges: dict[str, list[tuple[str, str, float]]] = {}
    for number, (name, stream, second) in enumerate(zip(names, streams, seconds, strict=True)):
        own = edges.setdefault(stream.name, [])
        own.append((parents[draw(st.integers(0, number))], name, number + 1.0))
        items.append(statics(stream, second / 10, *own, seq=number))
    return sorted(items, key=lambda item: item.log_ns)


@settings(deadline=None, max_examples=examples(60))
@given(items=recordings(), chunk=st.integers(1, 8))
def test_lookups_are_those_of_a_buffer_with_all(
    tmp_path_factory: pytest.TempPathFactory, items: list[Item], chunk: int
) -> None:
    """At each stamp, between any frames, `lookup_transform` answers as `Recording.buffer()`."""
    path = tmp_path_factory.mktemp("drawn") / "run.mcap"
    with RecordingWriter(path) as writer:
        for number, item in enumerate(items):
            writer.write(item)
            if number % chunk == 0:
                writer.flush()
    with tfbus.Recording(path) as recording:
        buffer = recording.buffer()
        for half in range(-1, 21):
            for frame in ("laser", "mast", "camera", "tool"):
                question = "map", frame, at(half / 2)
                assert answer(recording, *question) == answer(buffer, *question)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """A robot for 10 s, whose laser is told after 6 s and camera after 8 s, one after the other."""
    items: list[Item] = [
        described(SIM, 0.0, ("map", "base", False)),
        *(sent(SIM, tenth / 10, ("map", "base", tenth / 10)) for tenth in range(100)),
        statics(MODEL, 6, ("base", "laser", 10.0)),
        statics(MODEL, 8, ("base", "laser", 10.0), ("laser", "camera", 20.0), seq=1),
    ]
    return write(tmp_path / "run.mcap", sorted(items, key=lambda item: item.log_ns))


def test_as_known_then_they_hold_from_when_they_came(path: Path) -> None:
    """With statics="then" a static transform is not known before."""
    with tfbus.Recording(path, statics="then") as recording:
        assert not recording.can_transform("map", "laser", at(5))
        assert recording.lookup_transform("map", "laser", at(7)).transform.x == 17.0
        assert not recording.can_transform("map", "camera", at(7))
        assert recording.lookup_transform("map", "camera", at(9)).transform.x == 39.0
    with pytest.raises(tfbus.InvalidArgumentException, match="always"):
        tfbus.Recording(path, statics="later")  # type: ignore[arg-type]  # what a user may give


@pytest.mark.parametrize(("known", "second"), [("always", 3.0), ("then", 9.0)])
def test_the_command_line_looks_up_alike(path: Path, known: Statics, second: float) -> None:
    """`echo --bag --at` finds a frame before its static transform came, unless asked not to."""

    def found(at_s: float) -> float:
        choice = BagChoice((path,), Moment(T0 + round(at_s * 1e9)), statics=known)
        return recorded_transform(choice, SETTINGS, None, "map", "camera").transform.x

    assert found(second) == pytest.approx(30.0 + second)
    if known == "then":
        with pytest.raises(tfbus.TfbusError, match="camera"):
            found(3.0)


def test_what_is_said_before_a_restart_is_found(tmp_path: Path) -> None:
    """`echo --bag --at` in the second before a publisher begins again, or a frame is removed."""
    again = publisher("sim", 5.0)
    items: list[Item] = [
        described(SIM, 0.0, ("map", "base", False), ("map", "arm", False)),
        *(
            sent(SIM, tenth / 10, ("map", "base", tenth / 10), ("map", "arm", 0.0))
            for tenth in range(50)
        ),
        described(again, 5.0, ("map", "base", False), ("map", "tool", False)),
        *(
            sent(again, tenth / 10, ("map", "base", tenth / 10), ("map", "tool", tenth / 10))
            for tenth in range(50, 80)
        ),
        described(again, 8.0, ("map", "base", False)),
        *(sent(again, tenth / 10, ("map", "base", tenth / 10)) for tenth in range(80, 100)),
    ]
    path = write(tmp_path / "run.mcap", sorted(items, key=lambda item: item.log_ns))
    for frame, second in (("base", 4.45), ("base", 4.85), ("tool", 7.65)):
        choice = BagChoice((path,), Moment(at(second)))
        found = recorded_transform(choice, SETTINGS, None, "map", frame)
        assert found.transform.x == pytest.approx(second)


@pytest.mark.parametrize("count", [100, 400])
def test_each_frame_is_looked_at_once(tmp_path: Path, count: int) -> None:
    """Static transforms that come one by one, as in bags of ROS, take no longer each if there are
    more of them.
    """
    path = write(
        tmp_path / "run.mcap",
        (statics(MODEL, number / 100, ("base", f"f{number}", 1.0)) for number in range(count)),
    )
    files = "recording/state.py", "recording/reader.py"
    lines = 0

    def trace(frame: FrameType, event: str, argument: Any) -> Any:
        nonlocal lines
        lines += event == "line" and frame.f_code.co_filename.endswith(files)
        return trace

    with RecordingReader(path) as reader:
        former = sys.gettrace()
        sys.settrace(trace)
        try:
            LastingStatics(reader.first_statics())
        finally:
            sys.settrace(former)
    assert count < lines < 100 * count
