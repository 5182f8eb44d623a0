"""Lanes of links: what TCP makes of a path that loses packets."""

import pytest

from tfbus.testing import Network
from tfbus.testing.links import Lane, Path

# Linux 6 between two hosts with a delay of 20 ms, 15 s each: the median and the 90th percentile of
# the times in which 100 bytes arrived, by the share of lost packets and messages a second.
MEASURED_S = {
    (0.05, 10): (0.020, 0.088),
    (0.05, 100): (0.021, 0.064),
    (0.2, 10): (0.062, 0.861),
    (0.2, 100): (0.060, 0.136),
}


@pytest.mark.parametrize(("loss", "rate_hz"), MEASURED_S)
def test_lost_packets_delay_as_by_linux(network: Network, loss: float, rate_hz: int) -> None:
    """Half and nine in ten of the messages arrive about as late as was measured, each in order."""
    lane = Lane(network.tasks, Path(0.02, 0.0, loss))
    sent_ns: list[int] = []
    late_s: list[float] = []

    def arrive() -> None:
        late_s.append((network.tasks.now_ns - sent_ns[len(late_s)]) / 1e9)

    for _ in range(2000):
        sent_ns.append(network.tasks.now_ns)
        lane.send(arrive)
        network.run(1 / rate_hz)
    network.run(60.0)
    assert len(late_s) == 2000
    late_s.sort()
    for found_s, measured_s in zip(
        (late_s[1000], late_s[1800]), MEASURED_S[loss, rate_hz], strict=True
    ):
        assert measured_s / 3 < found_s < 3 * measured_s
