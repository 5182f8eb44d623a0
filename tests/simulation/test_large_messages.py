"""Images over a link that carries fewer than are sent."""

from itertools import pairwise

import numpy as np
import pytest

import tfbus
from tests.buses import keep_sending
from tfbus.base import scheduler
from tfbus.messages import CompressedImage
from tfbus.testing import Network, Process

_BYTES = 100_000
_MBIT = 125_000.0


def _data(stamp_ns: int) -> np.ndarray:
    """The data of the image of a stamp: noise, that a part of another one would not fit to."""
    return np.random.default_rng(stamp_ns).integers(0, 255, _BYTES, np.uint8)


def _settings(name: str, profile: str) -> tfbus.NodeSettings:
    return tfbus.NodeSettings(name, network=profile)


def _film(network: Network, profile: str, *, hz: float = 5.0) -> Process:
    """A camera on the robot."""

    def film() -> None:
        with tfbus.Node(settings=_settings("camera", profile)) as node:
            publisher = node.create_publisher(CompressedImage, "camera")

            def send() -> None:
                now_ns = node.now_ns()
                publisher.publish(CompressedImage(now_ns, "camera", "jpeg", _data(now_ns)))

            node.create_timer(1.0 / hz, send)
            node.spin()

    return network.start(network.host("robot"), "camera", film)


class _Viewer:
    """A subscriber to the images on a host: when each came, and its age."""

    def __init__(self, network: Network, host: str, profile: str) -> None:
        self.came_s: list[float] = []
        self.ages_s: list[float] = []
        self.stamps: list[int] = []
        with network.process(network.host(host), "viewer"):
            self.node = tfbus.Node(settings=_settings("viewer", profile))
            self.node.create_subscription(CompressedImage, "camera", self._see)

    def _see(self, image: CompressedImage) -> None:
        assert np.array_equal(image.data, _data(image.stamp_ns))
        self.came_s.append(scheduler.monotonic())
        self.ages_s.append((self.node.now_ns() - image.stamp_ns) / 1e9)
        self.stamps.append(image.stamp_ns)

    @property
    def longest_gap_s(self) -> float:
        """The longest time between two images."""
        return max(after - before for before, after in pairwise(self.came_s))


@pytest.mark.parametrize(
    ("profile", "delay_s"), [("wifi", 0.01), ("mobile", 0.06), ("satellite", 0.3)]
)
def test_images_come_again_and_again_over_a_link_that_has_no_room_for_all(
    network: Network, profile: str, delay_s: float
) -> None:
    """Each whole, newer than the one before, and seconds old; transforms beside them in time."""
    robot, base = network.host("robot"), network.host("base")
    network.path(robot, base, delay_s=delay_s, bytes_a_second=_MBIT)
    _film(network, profile)
    with network.process(robot, "driver"):
        keep_sending(tfbus.Node(settings=_settings("driver", profile)), "world", "base")
    viewer = _Viewer(network, "base", profile)
    with network.process(base, "listener"):
        buffer = tfbus.Buffer()
        tfbus.TransformListener(buffer, tfbus.Node(settings=_settings("listener", profile)))
    network.run(until=lambda: viewer.came_s and "base" in buffer.frames())
    ages_s = []
    for _ in range(600):
        network.run(0.1)
        ages_s.append((network.now_ns - (buffer.frame("base").newest_ns or 0)) / 1e9)
    assert viewer.longest_gap_s < 5.0 and max(viewer.ages_s) < 5.0
    assert viewer.stamps == sorted({*viewer.stamps})
    assert max(ages_s) < delay_s + 0.5


def test_a_viewer_behind_a_narrow_link_holds_up_no_other(network: Network) -> None:
    """Others get all images, also one of no such profile; and that one gets some."""
    network.path(network.host("robot"), network.host("base"), delay_s=0.06, bytes_a_second=_MBIT)
    far = _Viewer(network, "base", "mobile")
    near = [_Viewer(network, host, "mobile") for host in ("robot", "desk")]
    near.append(_Viewer(network, "plain", "lan"))
    _film(network, "mobile")
    network.run(until=lambda: len(far.came_s) > 20)
    for each in near:
        assert each.longest_gap_s < 0.3
        assert each.stamps == sorted({*each.stamps})


def test_images_come_from_a_camera_that_was_restarted(network: Network) -> None:
    """Its next images come as before."""
    network.path(network.host("robot"), network.host("base"), delay_s=0.06, bytes_a_second=_MBIT)
    camera = _film(network, "mobile")
    viewer = _Viewer(network, "base", "mobile")
    for _ in range(3):
        before = len(viewer.came_s)
        network.run(until=lambda before=before: len(viewer.came_s) > before + 2)
        network.restart(camera)


def test_who_subscribes_later_gets_no_image_of_before(network: Network) -> None:
    """The topic retains none, on whatever network."""
    with network.process(network.host("robot"), "camera"):
        node = tfbus.Node(settings=_settings("camera", "wifi"))
        publisher = node.create_publisher(CompressedImage, "camera")
        now_ns = node.now_ns()
        publisher.publish(CompressedImage(now_ns, "camera", "jpeg", _data(now_ns)))
    network.run(30.0)
    viewer = _Viewer(network, "base", "wifi")
    network.run(30.0)
    assert viewer.stamps == []


def test_images_come_after_a_link_was_cut(network: Network) -> None:
    """Whatever it cut off is forgotten."""
    network.path(network.host("robot"), network.host("base"), delay_s=0.06, bytes_a_second=_MBIT)
    _film(network, "mobile")
    viewer = _Viewer(network, "base", "mobile")
    for cut_s in (0.5, 3.0, 15.0):
        before = len(viewer.came_s)
        network.run(until=lambda before=before: len(viewer.came_s) > before + 2)
        network.cut("robot", "base")
        network.run(cut_s)
        network.heal()
