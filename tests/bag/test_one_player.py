"""All doors of a player do the same: keys of `bag play`, the view's bar, Foxglove's playback."""

from pathlib import Path
from random import Random
from types import SimpleNamespace
from typing import Any, Protocol

import pytest

from tests.builders import S, examples
from tests.recordings import at, described, publisher, sent, write

pytest.importorskip("mcap", reason="needs mcap: the extra bag")
pytest.importorskip("viser", reason="needs viser: the extra view")
pytest.importorskip("websockets", reason="needs websockets: the extra foxglove")

from tfbus.bag.player import Player
from tfbus.base import scheduler
from tfbus.cli.bag.play_run import follow
from tfbus.foxglove import playback
from tfbus.foxglove.protocol import PlaybackControl
from tfbus.recording.playhead import FASTEST, SLOWEST, AtEnd, Progress
from tfbus.recording.reader import RecordingReader
from tfbus.testing.network import Network
from tfbus.view.panels.markup import Channel
from tfbus.view.panels.player import PlayerBar
from tfbus.view.replay import Replay

# All times are multiples of an eighth of a second, so that a page's pictures meet each of them.
END_S = 8.0
PICTURE_S = 1 / 16

# A command, and what it is given.
Command = tuple[str, float]


class Door(Protocol):
    """A way to move a recording."""

    def do(self, command: str, given: float) -> None:
        """Play, pause, seek to a second, step, or set the rate."""

    def draw(self) -> None:
        """Show a picture, if it is one that draws."""

    def progress(self) -> Progress:
        """How far it is."""


class Nothing:
    """A stage that only says how many items came."""

    def begin(self, *given: Any, **more: Any) -> None:
        """The state."""

    def take(self, *given: Any) -> None:
        """An item."""

    def follow(self, *given: Any) -> None:
        """A change."""


class Keys:
    """`bag play`: its keys, and what its services call."""

    def __init__(self, reader: RecordingReader, at_end: AtEnd) -> None:
        self.player = Player(reader, paused=True, at_end=at_end)
        self.thread = scheduler.Thread(target=self.player.run, args=(Nothing(),), daemon=True)
        self.thread.start()

    def do(self, command: str, given: float) -> None:
        if command == "seek":
            self.player.seek(at(given))
        elif command == "rate":
            self.player.set_rate(given)
        elif command == "step":
            follow("." if given > 0 else ",", self.player)
        elif self.player.progress.is_paused is (command == "play"):
            follow(" ", self.player)

    def draw(self) -> None:
        """It publishes."""

    def progress(self) -> Progress:
        return self.player.progress


class Bar:
    """The page of `tfbus view`: the events of its bar, and a picture every sixteenth second."""

    def __init__(self, reader: RecordingReader, at_end: AtEnd) -> None:
        self._channel, self._seeks = Channel(), 0
        self._replay = Replay(reader, at_ns=reader.start_ns)
        gui: Any = SimpleNamespace(
            add_html=lambda content: SimpleNamespace(content=content),
            add_command=lambda *_, **__: SimpleNamespace(on_trigger=lambda callback: None),
        )
        PlayerBar(gui, self._channel, self._replay)
        self._send("loop", loops=at_end == "loop")
        self.draw()

    def _send(self, command: str, **given: object) -> None:
        self._channel.receive({"do": command, **given}, 1)

    def do(self, command: str, given: float) -> None:
        self._seeks += 1
        match command:
            case "play" | "pause":
                self._send("play", plays=command == "play")
            case "seek":
                self._send("seek", s=given, n=self._seeks)
            case "rate":
                self._send("speed", speed=given)
            case "step":
                self._send("step", by=int(given))

    def draw(self) -> None:
        self._replay.move(scheduler.monotonic(), is_watched=True)

    def progress(self) -> Progress:
        return self._replay.playhead.progress


class Foxglove:
    """Foxglove's playback: its controls, which say all at once; it has no steps of its own."""

    def __init__(self, path: Path, reader: RecordingReader, at_end: AtEnd) -> None:
        self._bridge = playback.PlaybackBridge(
            [path], (reader.start_ns, reader.end_ns), playback.Serving(port=0), at_end=at_end
        )
        self.player = self._bridge.player
        self.thread = scheduler.Thread(target=self.player.run, args=(self._bridge,), daemon=True)
        self.thread.start()

    def do(self, command: str, given: float) -> None:
        if command == "step":
            self.player.step(int(given))
            return
        now = self.player.progress
        self._bridge.control(
            PlaybackControl(
                command == "play" or (command != "pause" and not now.is_paused),
                given if command == "rate" else now.rate,
                at(given) if command == "seek" else None,
                "request",
            )
        )

    def draw(self) -> None:
        """It publishes."""

    def progress(self) -> Progress:
        return self.player.progress


class NoFront:
    """A door to the network that is not there."""

    def __init__(self, *given: Any) -> None:
        """Listens nowhere."""


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Eight seconds, with a message each quarter."""
    sim = publisher("sim")
    times = [number / 4 for number in range(1, round(END_S * 4) + 1)]
    rows = [described(sim, 0.0, ("map", "base", False))]
    moves = [sent(sim, time, ("map", "base", time), stamp_ns=at(time)) for time in times]
    return write(tmp_path_factory.mktemp("doors") / "run.mcap", [*rows, *moves])


def commands(seed: int) -> list[tuple[float, Command]]:
    """Commands, each so many seconds after the one before."""
    random = Random(seed)
    drawn: list[tuple[float, Command]] = []
    for _ in range(40):
        apart_s = random.randrange(1, 9) / 4
        command: Command = random.choice(
            [
                ("play", 0.0),
                ("play", 0.0),
                ("pause", 0.0),
                ("seek", random.choice([0.0, END_S, random.randrange(32) / 4 + 0.125])),
                ("step", random.choice([-1.0, 1.0])),
                ("rate", random.choice([0.5, 1.0, 2.0])),
            ]
        )
        drawn.append((apart_s, command))
    return drawn


@pytest.mark.parametrize("at_end", ["wait", "loop"])
@pytest.mark.parametrize("seed", range(examples(6)))
def test_the_same_commands_lead_to_the_same_times(
    path: Path, seed: int, at_end: AtEnd, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Through all doors, in virtual time: and whether it plays, how fast, and in which round.

    To a microsecond, since in that time the tasks of the network take some nanoseconds.
    """
    monkeypatch.setattr(playback, "Front", NoFront)
    with Network(seed=seed) as network, network.process("outside", "doors"):
        readers = [RecordingReader(path) for _ in range(3)]
        doors: list[Door] = [
            Keys(readers[0], at_end),
            Bar(readers[1], at_end),
            Foxglove(path, readers[2], at_end),
        ]
        for apart_s, (command, given) in commands(seed):
            for _ in range(round(apart_s / PICTURE_S)):
                network.run(PICTURE_S)
                for door in doors:
                    door.draw()
            places = [said(door.progress()) for door in doors]
            assert places[1:] == [pytest.approx(places[0], abs=1e-6)] * 2, (seed, command, given)
            for door in doors:
                door.do(command, given)
        for each in doors:
            if isinstance(each, Keys | Foxglove):
                each.player.stop()
                each.thread.join()
        for reader in readers:
            reader.close()


def said(progress: Progress) -> tuple[float, bool, bool, float, int]:
    """The cursor times of all doors."""
    place_s = (progress.log_ns - progress.start_ns) / S
    return place_s, progress.is_paused, progress.is_at_end, progress.rate, progress.loops


def test_all_doors_have_one_range_of_rates(path: Path) -> None:
    """A door that cannot refuse takes the nearest rate."""
    with RecordingReader(path) as reader:
        bar = Bar(reader, "wait")
        for given, rate in ((1e6, FASTEST), (0.0, SLOWEST), (33.0, 33.0)):
            bar.do("rate", given)
            assert bar.progress().rate == rate
