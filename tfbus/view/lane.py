"""The order in which a browser gets messages of viser: frames first, large data as its link allows.

All that a browser gets goes through one connection, so that a cloud or an image delays the frames
behind it. Here large messages wait aside, the newest of each kind, and one goes at a time, after a
pause as long as the one before took: frames have half of the link at least, and a slow browser
gets fewer images.
"""

import asyncio
import time
from collections.abc import AsyncGenerator, Callable, Sequence
from typing import Any

import numpy as np

# A message is large from so many bytes on.
LARGE_BYTES = 16_384


class Lane:
    """The messages for one browser; `skipped` large ones were overtaken by newer ones."""

    def __init__(self) -> None:
        self.skipped = 0
        # By the key under which viser replaces messages, the oldest first.
        self._waiting: dict[str, Any] = {}
        self._free_s = 0.0

    def pass_on(self, messages: Sequence[Any]) -> list[Any]:
        """The messages that go at once. The large ones wait, and with them later ones about the
        same thing, until they go or the thing is removed.
        """
        now = []
        for message in messages:
            entity = _entity_of(message)
            if message.lifecycle_phase == "remove" and entity is not None:
                self._forget(entity)
            elif is_large(message) or (entity is not None and self._waits(entity)):
                self._put(message)
                continue
            now.append(message)
        return now

    def due_s(self) -> float | None:
        """When the next large message may go, of a steady clock; None if none waits."""
        return self._free_s if self._waiting else None

    def take(self) -> list[Any]:
        """The large message that has waited longest, with the small ones about the same thing."""
        first = next(iter(self._waiting.values()))
        entity = _entity_of(first)
        if entity is None:
            taken = [_key_of(first)]
        else:
            taken = [key for key, each in self._waiting.items() if _entity_of(each) == entity]
        return [self._waiting.pop(key) for key in taken]

    def sent(self, begin_s: float, end_s: float) -> None:
        """Note how long the link took for the last window."""
        self._free_s = end_s + (end_s - begin_s)

    def _put(self, message: Any) -> None:
        key = _key_of(message)
        if key in self._waiting:
            self.skipped += is_large(message)
            if message.lifecycle_phase == "create":
                # Changes of the one before are not for the new one.
                entity = _entity_of(message)
                for other in [at for at, each in self._waiting.items() if at != key]:
                    if _entity_of(self._waiting[other]) == entity:
                        del self._waiting[other]
        self._waiting[key] = message

    def _waits(self, entity: tuple[str, str]) -> bool:
        return any(_entity_of(each) == entity for each in self._waiting.values())

    def _forget(self, entity: tuple[str, str]) -> None:
        """Drop waiting messages about a thing, and about the things below it in the scene."""
        kind, name = entity
        for key, each in list(self._waiting.items()):
            other = _entity_of(each)
            if other is None or other[0] != kind:
                continue
            if other[1] == name or other[1].startswith(f"{name}/"):
                del self._waiting[key]


def _key_of(message: Any) -> str:
    return str(message.redundancy_key())


def _entity_of(message: Any) -> tuple[str, str] | None:
    """The thing that a message makes, changes or removes, by its kind and name."""
    if message.entity_type is not None and message.entity_id_field is not None:
        return message.entity_type, getattr(message, message.entity_id_field)
    key: tuple[str, str] | None = message.entity_state_key()
    return key


def is_large(message: Any) -> bool:
    """Whether a message takes so long on a link that others should not wait for it."""
    for values in (getattr(message, "props", None), getattr(message, "updates", None)):
        if values is not None:
            each = values if isinstance(values, dict) else vars(values)
            if sum(map(_bytes_of, each.values())) >= LARGE_BYTES:
                return True
    return False


def _bytes_of(value: object) -> int:
    if isinstance(value, np.ndarray):
        return value.nbytes
    return len(value) if isinstance(value, bytes | str) else 0


async def in_lanes(
    windows: AsyncGenerator[Sequence[Any], None],
    marker: Any,
    clock_s: Callable[[], float] = time.monotonic,
) -> AsyncGenerator[Sequence[Any], None]:
    """The windows to send a browser, made of viser's own. The sender asks for the next once the
    link has taken the one before.

    All that is there when the browser comes, which ends with the `marker`, goes first, as it is.
    """
    lane = Lane()
    is_new = marker is not None
    coming: asyncio.Future[Sequence[Any]] = asyncio.ensure_future(anext(windows))
    try:
        while True:
            due_s = lane.due_s()
            wait_s = None if due_s is None else max(0.0, due_s - clock_s())
            await asyncio.wait([coming], timeout=wait_s)
            if coming.done():
                try:
                    window = coming.result()
                except StopAsyncIteration:
                    return
                coming = asyncio.ensure_future(anext(windows))
                if is_new:
                    is_new = not any(each is marker for each in window)
                    yield window
                elif now := lane.pass_on(window):
                    yield now
            due_s = lane.due_s()
            if due_s is not None and due_s <= (begin_s := clock_s()):
                yield lane.take()
                lane.sent(begin_s, clock_s())
    finally:
        coming.cancel()
        await asyncio.gather(coming, return_exceptions=True)
        await windows.aclose()
