"""The messages to a browser over a slow link: frames in time, and images as there is room."""

import asyncio
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("viser", reason="needs viser: the extra view")

from viser import _messages as viser_messages
from viser.infra._async_message_buffer import AsyncMessageBuffer

from tfbus.view.lane import LARGE_BYTES, Lane, in_lanes

LINK_BYTES_S = 250_000.0
IMAGE_BYTES = 50_000
FRAMES_HZ, IMAGES_HZ, SECONDS = 30, 15, 8


class VirtualLoop(asyncio.SelectorEventLoop):
    """An event loop whose time goes on at once to when something is due."""

    now_s = 0.0

    def time(self) -> float:
        """The virtual time."""
        return self.now_s

    def _run_once(self) -> None:
        scheduled, ready = self._scheduled, self._ready  # type: ignore[attr-defined]
        if scheduled and not ready:
            self.now_s = max(self.now_s, scheduled[0].when())
        super()._run_once()  # type: ignore[misc]


def frame(number: int) -> Any:
    """A movement of a frame; its x is the number."""
    return viser_messages.SetPositionMessage("/fixed/base", (float(number), 0.0, 0.0))


def image(topic: str, number: int) -> Any:
    """An image of the panel; its first byte is the number."""
    data = bytes([number]) * IMAGE_BYTES
    return viser_messages.GuiUpdateMessage(topic, {"_data": data})


def cloud(number: int, name: str = "/fixed/data/1/0") -> Any:
    """A large cloud; its first point is the number."""
    points = np.full((LARGE_BYTES, 3), float(number), np.float32)
    props: Any = SimpleNamespace(points=points)
    return viser_messages.PointCloudMessage(name, props)


def bytes_of(messages: Any) -> int:
    """About how many bytes these take on the link."""
    return sum(IMAGE_BYTES if hasattr(each, "updates") else 100 for each in messages)


def test_a_slow_browser_gets_its_frames_in_time_and_fewer_images() -> None:
    """Frames wait for one image at most, half of the link is for images, and the last one comes."""
    loop = VirtualLoop()
    buffer = AsyncMessageBuffer(loop, persistent_messages=True)
    ages_s: list[float] = []
    images: list[tuple[str, int]] = []

    async def send() -> None:
        for number in range(SECONDS * FRAMES_HZ):
            buffer.push(frame(number))
            if number % (FRAMES_HZ // IMAGES_HZ) == 0:
                buffer.push(image("left", number))
                buffer.push(image("right", number))
            buffer.flush()
            await asyncio.sleep(1.0 / FRAMES_HZ)

    async def browse() -> None:
        async for window in in_lanes(buffer.window_generator(0), None, loop.time):
            await asyncio.sleep(bytes_of(window) / LINK_BYTES_S)
            for message in window:
                if hasattr(message, "updates"):
                    images.append((message.uuid, message.updates["_data"][0]))
                else:
                    ages_s.append(loop.time() - message.position[0] / FRAMES_HZ)

    async def both() -> None:
        browser = asyncio.ensure_future(browse())
        await send()
        await asyncio.sleep(1.0)
        browser.cancel()
        await asyncio.gather(browser, return_exceptions=True)

    loop.run_until_complete(both())
    loop.close()
    image_s = IMAGE_BYTES / LINK_BYTES_S
    assert max(ages_s) <= image_s + 0.1
    assert len(images) == pytest.approx(SECONDS / (2.0 * image_s), rel=0.2)
    left = [number for topic, number in images if topic == "left"]
    right = [number for topic, number in images if topic == "right"]
    assert abs(len(left) - len(right)) <= 1
    assert left == sorted(left)
    newest = SECONDS * FRAMES_HZ - 2
    assert {left[-1], right[-1]} == {newest}


def test_what_is_about_a_large_message_comes_behind_it_and_not_after_its_end() -> None:
    """A cloud that is replaced meanwhile is skipped, and one that is removed never comes."""
    lane = Lane()
    moved = viser_messages.SetPositionMessage("/fixed/data/1/0", (1.0, 0.0, 0.0))
    hidden = viser_messages.SetSceneNodeVisibilityMessage("/fixed/data/1/0", False)
    assert lane.pass_on([cloud(1), moved, frame(7)])[0].name == "/fixed/base"
    last = cloud(2)
    assert lane.pass_on([last, hidden]) == []
    assert lane.take() == [last, hidden]
    assert (lane.due_s(), lane.skipped) == (None, 1)
    assert lane.pass_on([moved]) == [moved]
    ended = viser_messages.RemoveSceneNodeMessage("/fixed/data/1")
    assert lane.pass_on([cloud(3), cloud(4, "/fixed/data/12/0"), ended]) == [ended]
    [other] = lane.take()
    assert (other.name, lane.due_s()) == ("/fixed/data/12/0", None)


def test_a_link_that_took_long_has_a_pause_as_long() -> None:
    """A fast one has none."""
    lane = Lane()
    lane.pass_on([cloud(1)])
    lane.take()
    lane.sent(10.0, 10.5)
    lane.pass_on([cloud(2)])
    assert lane.due_s() == 11.0
