"""The tab of a fleet in the view."""

import pytest

from tests.builders import S

pytest.importorskip("viser", reason="needs viser: the extra view")

from tfbus.frames.fleet import RobotStatus
from tfbus.view.panels.panel import fleet_rows


def test_a_row_says_how_a_robot_is() -> None:
    """A robot has its age, rate and clock if that is off, or since when it is gone; names are
    text, and many robots are counted.
    """
    html = fleet_rows(
        [
            RobotStatus("robot4", "gone", gone_ns=0),
            RobotStatus("<b>7", "missing"),
            RobotStatus("robot2", "there", age_s=0.02, messages_hz=10.0, clock_offset_s=2.5),
        ],
        180 * S,
    )
    assert "1 of 3 robots there" in html
    assert "gone 3 min" in html and "missing" in html
    assert "<b>7" not in html and "&lt;b&gt;7" in html
    assert "10 Hz" in html and "2.5 s" in html
    many = fleet_rows([RobotStatus(f"robot{n}", "there") for n in range(1000)], 0)
    assert many.count("data-fleet-row") < 200
