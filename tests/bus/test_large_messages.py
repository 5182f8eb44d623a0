"""Large messages of topics on a network that carries few of them."""

import pytest

from tests.buses import eventually
from tests.simulated_bus import Bus
from tfbus.messages import Image

RAW = Image(1, "camera", 480, 640, "rgb8", 0, 1920, bytes(921_600))
SMALL = Image(1, "camera", 48, 64, "rgb8", 0, 192, bytes(9_216))


@pytest.mark.parametrize(
    ("profile", "image", "warnings"), [("wifi", RAW, 1), ("wifi", SMALL, 0), ("lan", RAW, 0)]
)
def test_the_first_very_large_message_on_a_bad_network_is_named(
    bus: Bus, caplog: pytest.LogCaptureFixture, profile: str, image: Image, warnings: int
) -> None:
    """The log says once that the next ones are dropped while one is on its way, and what helps."""
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
