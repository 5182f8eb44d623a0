"""Laws of the protocol under random histories: `python -m tests.simulation` runs more of them."""

import subprocess
import sys

import pytest

from tests.simulation.histories import Run, violation
from tests.simulation.injected import injected
from tests.simulation.plans import Plan


def _histories(*options: str) -> str:
    """The output of the command; the order of sets, and so a history, never changes."""
    command = [sys.executable, "-m", "tests.simulation", *options]
    return subprocess.run(command, capture_output=True, text=True, check=False).stdout


@pytest.mark.real
def test_no_history_violates_a_law() -> None:
    """Twenty histories hold all laws."""
    assert "20 histories from seed 0" in (said := _histories("--seeds", "20", "--no-shrink"))
    assert "0 failed" in said, said


def test_a_seed_repeats_its_history_to_the_turn() -> None:
    """Two runs of a seed take the same turns at the same times."""
    first, second = (_turns(Plan.drawn(7)) for _ in range(2))
    assert first == second


def test_a_defect_that_is_put_back_is_found() -> None:
    """A timer that is not cancelled violates a law."""
    with injected("a timer is not cancelled"):
        assert any("a cancelled timer ticks" in (violation(Plan.drawn(n)) or "") for n in range(5))


def _turns(plan: Plan) -> tuple[int, int]:
    run = Run(plan)
    run.run()
    return run.network.tasks.turns, run.network.tasks.now_ns
