"""Large messages of topics on a network that carries few of them."""

import numpy as np
import pytest

from tests.buses import eventually
from tests.simulated_bus import Bus
from tfbus.messages import Image

RAW = Image(1, "camera", 480, 640, "rgb8", 0, 1920, np.zeros(921_600, np.uint8))
SMALL = Image(1, "camera", 48, 64, "rgb8", 0, 192, np.zeros(9_216, np.uint8))


@pytest.mark.parametrize(
    ("profile", "image", "warnings"), [("wifi", RAW, 1), ("wifi", SMALL, 0), ("lan", RAW, 0)]
)
def test_the_first_large_message_on_a_bad_network_is_named(
    bus: Bus, caplog: pytest.LogCaptureFixture, profile: str, image: Image, warnings: int
) -> None:
    """The log says once how much waits for a link there, and what helps."""
    received: list[Image] = []
    driver = bus.node("driver", network=profile)
    driver.log.addHandler(caplog.handler)
    publisher = driver.create_publisher(Image, "camera")
    publisher.publish(image)
    bus.node("viewer", network=profile).create_subscription(Image, "camera", received.append)
    eventually(lambda: publisher._publisher.heard)
    assert not caplog.messages
    for _ in range(3):
        publisher.publish(image)
    eventually(lambda: len(received) == 3)
    said = [line for line in caplog.messages if "CompressedImage" in line]
    assert len(said) == warnings
    assert all(
        "'camera' has messages of 922 kB" in line and f"{profile!r}" in line for line in said
    )
