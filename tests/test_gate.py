"""The gate of the hot paths compares instructions with former counts."""

import pytest

from benchmarks.gate import CALIBRATION, compare

BEFORE = {CALIBRATION: 1000, "send 1": 10_000}


@pytest.mark.parametrize(
    ("python", "send", "passes"),
    [
        (1000, 10_290, True),
        (1000, 10_310, False),
        (1000, 5_000, True),
        # Built otherwise: by the ratio to what Python itself takes, and with more tolerance.
        (2000, 21_900, True),
        (2000, 22_100, False),
    ],
)
def test_more_instructions_than_before_are_named(python: int, send: int, passes: bool) -> None:
    """Where they are 3 % more, or 10 % more of what Python itself takes here."""
    mistakes = list(compare(BEFORE, {CALIBRATION: python, "send 1": send}))
    assert [line.partition(":")[0] for line in mistakes] == ([] if passes else ["send 1"])


def test_a_path_without_a_number_is_named() -> None:
    """So that none is added without one."""
    (line,) = compare(BEFORE, {**BEFORE, "receive 1": 5})
    assert line.startswith("receive 1: ")
