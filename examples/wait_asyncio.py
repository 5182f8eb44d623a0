"""Waits for transforms in asyncio: two lookups at once, while the loop does other work.

    python examples/wait_asyncio.py

It ends when broadcaster.py and static_frames.py run, or with an error after ten seconds.
"""

import asyncio
from contextlib import suppress

from tfbus import Buffer, Node, TimeoutException, TransformListener


async def find(buffer: Buffer, target: str, source: str) -> None:
    try:
        pose = await buffer.wait_for_transform(target, source, timeout_s=10.0)
    except TimeoutException as error:
        print(f"{source} in {target}: {error}")
    else:
        print(f"{source} in {target}: {pose.transform.xyz.round(2)}")


async def main() -> None:
    buffer = Buffer()
    with Node.from_args("async_listener") as node, TransformListener(buffer, node):
        await asyncio.gather(
            find(buffer, "world", "camera"),
            find(buffer, "base_link", "lidar"),
        )


if __name__ == "__main__":
    with suppress(KeyboardInterrupt):
        asyncio.run(main())
