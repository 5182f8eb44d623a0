"""Laws of the protocol under random histories: `python -m tests.simulation` runs more of them."""

import pytest

from tests.simulation.histories import violation
from tests.simulation.plans import Plan


@pytest.mark.parametrize("seed", range(40))
def test_no_history_violates_a_law(seed: int) -> None:
    """Each listener ends with what living publishers hold, and no lookup answers with another."""
    assert violation(Plan.drawn(seed)) is None


def test_a_seed_repeats_its_history_to_the_turn() -> None:
    """Two runs of a seed take the same turns at the same times."""
    first, second = (_turns(Plan.drawn(7)) for _ in range(2))
    assert first == second


def _turns(plan: Plan) -> tuple[int, int]:
    from tests.simulation.histories import Run

    run = Run(plan)
    run.run()
    return run.network.tasks.turns, run.network.tasks.now_ns
