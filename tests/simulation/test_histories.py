"""Laws of the protocol under random histories: `python -m tests.simulation` runs more of them."""

import os
import subprocess
import sys
from dataclasses import replace
from itertools import zip_longest
from pathlib import Path

import pytest

import tfbus
from tests.simulation.histories import Part, Run, shrunk, violation
from tests.simulation.injected import injected
from tests.simulation.model import Publisher
from tests.simulation.plans import LARGE, SMALL, Plan, Size
from tests.simulation.told import Told
from tfbus.buffer.info import Change

# Histories that a defect of tfbus or of a law made fail: the seed, and which actions are left.
_FAILED_ONCE = (
    # Of two publishers of a stream, the static transforms of the former one stayed.
    (SMALL, 661676859335, ()),
    # An answer took the place of a newer description of a stream, whose frame stayed.
    (SMALL, 661246620725, ()),
    # After a clock was set back, the first of two publishers of a stream did not count again.
    (LARGE, 3, (146, 182, 589, 628, 656, 700)),
    # By the law a plain stream, of which messages still came, was not to follow one that was over.
    (SMALL, 955148245333, (0, 22, 23, 24, 25, 27)),
    # Answers by a slow path came when they were no longer waited for.
    (SMALL, 471283982219, (0, 1, 2, 4, 5, 6, 15)),
    # By the law a frame that was removed once was there before its publisher sent it again.
    (LARGE, 5, (25, 29, 126, 363, 364)),
    # Late static transforms of a process that had ended were taken for those of its successor.
    (SMALL, 5973, ()),
    # The same, of a listener that had begun in between.
    (SMALL, 105, ()),
    # A stopped listener had the word of an ended process wait, and could not reach its successor.
    (SMALL, 625873032276, (0, 1, 2, 5, 6, 7, 8, 9, 10, 11, 30)),
    # The word of a process that waited so long ended the silence after its end: it lived for ever.
    (SMALL, 803224780011, (0, 7, 9, 10, 12)),
    # By the law a listener that was stopped was not to read the messages of that time.
    (SMALL, 262277161448, (1, 2, 6, 10, 11, 12, 19)),
)


def _histories(*options: str, hashes: str = "random") -> str:
    """The output of the command."""
    command = [sys.executable, "-m", "tests.simulation", *options]
    environment = {**os.environ, "PYTHONHASHSEED": hashes}
    ended = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    return f"{ended.stdout}{ended.stderr}exit code {ended.returncode}"


@pytest.mark.real
def test_no_history_violates_a_law() -> None:
    """Twenty histories hold all laws."""
    assert "20 histories from seed 0" in (said := _histories("--seeds", "20", "--no-shrink"))
    assert "0 failed" in said, said


def test_a_seed_repeats_its_history_to_the_turn() -> None:
    """Two runs of a seed take the same turns at the same times."""
    first, second = (_turns(Plan.drawn(7)) for _ in range(2))
    assert first == second


@pytest.mark.parametrize(("size", "seed", "left"), _FAILED_ONCE)
def test_a_history_that_failed_once_holds_all_laws(
    size: Size, seed: int, left: tuple[int, ...]
) -> None:
    """No law is violated by a history that violated one before its mend."""
    plan = Plan.drawn(seed, size)
    assert violation(plan.only(plan.actions[n] for n in left) if left else plan) is None


@pytest.mark.real
def test_a_seed_repeats_its_history_to_the_message_in_every_process(tmp_path: Path) -> None:
    """In two processes, whose hashes differ, a seed sends the same messages at the same times."""
    logs = tmp_path / "first", tmp_path / "second"
    for log, hashes in zip(logs, ("1", "2"), strict=True):
        said = _histories("--seeds", "6", "--from", "104", "--log", str(log), hashes=hashes)
        # One that fails is run again with fewer actions, whose messages are others.
        assert "6 histories from seed 104" in said, said
        assert ", 0 failed" in said, said
    first, second = (log.read_text().splitlines() for log in logs)
    assert len(first) > 1000
    for at, (one, other) in enumerate(zip_longest(first, second)):
        assert one == other, "\n".join(
            ["the first goes on", *first[at - 5 : at + 5], "the second", *second[at - 5 : at + 5]]
        )


@pytest.mark.parametrize(("stalls", "is_allowed"), [(0.0, False), (0.01, True)])
def test_the_end_of_a_process_is_under_way_for_longer_where_tasks_stall(
    stalls: float, is_allowed: bool
) -> None:
    """A frame may be back 20 s after the end of its process where tasks get no processor."""
    run = Run(replace(Plan.drawn(4, LARGE), stalls=stalls))
    publisher = Publisher(1, "p35", ever_sent={"p35_moving"})
    run.publishers["p35"] = [publisher]
    change = Change("publisher back", "p35_moving", "world", "world", "p35", "p35", 0)
    with run.network as network:
        host = network.host("h0")
        process = run.readers["l9"] = network.start(host.name, "l9", lambda: None)
        run.laws.note_calm()
        run.laws.died_s[publisher.number] = run.now_s - 20.0
        run.laws.check_change(Part("l9", process, None, None, None, Told(tfbus.Buffer())), change)
    assert bool(run.violations) is not is_allowed


def test_a_frame_of_which_a_buffer_has_not_told_is_noticed() -> None:
    """The frames by its changes are held against those that it has, gone ones as such."""
    buffer = tfbus.Buffer()
    told = Told(buffer)
    arm = tfbus.TransformStamped(1, "world", "arm", tfbus.Transform())
    buffer.set_transform(arm, authority="robot")
    assert told.mistake() == ""
    buffer.mark_gone(["arm"], True, "robot")
    assert told.mistake() == ""
    assert "('arm', True)" in Told(buffer).mistake()


def test_a_defect_that_is_put_back_is_found() -> None:
    """A timer that is not cancelled violates a law."""
    with injected("a timer is not cancelled"):
        assert any("a cancelled timer ticks" in (violation(Plan.drawn(n)) or "") for n in range(5))


def test_a_history_that_fails_is_made_smaller() -> None:
    """Of its actions those are left without which it holds all laws."""
    plan = Plan.drawn(0)
    with injected("a timer is not cancelled"):
        smallest = shrunk(plan)
        assert violation(smallest)
        actions = smallest.actions
        assert len(actions) < len(plan.actions)
        for left_out in actions:
            assert not violation(smallest.only(each for each in actions if each is not left_out))


def _turns(plan: Plan) -> tuple[int, int]:
    run = Run(plan)
    run.run()
    return run.network.tasks.turns, run.network.tasks.now_ns
