"""Answers in asyncio, over HTTP, where a frame is: for programs without tfbus.

    python examples/http_service.py
    curl 'http://127.0.0.1:8000/world/camera'

The path names the target and the source. A request waits up to two seconds for the transform, and
many wait at once. Only programs on this machine can ask. Ctrl-C ends it.
"""

import asyncio
import json
import signal
from contextlib import suppress
from functools import partial
from http import HTTPStatus
from urllib.parse import unquote

from tfbus import Buffer, Node, TransformException, TransformListener


async def find(buffer: Buffer, request: str) -> tuple[HTTPStatus, object]:
    """The status and the JSON for the first line of a request."""
    match [unquote(part) for part in request.partition(" HTTP/")[0].split("/")]:
        case ["GET ", target, source]:
            try:
                pose = await buffer.wait_for_transform(target, source, timeout_s=2.0)
            except TransformException as error:
                return HTTPStatus.NOT_FOUND, {"error": str(error)}
            return HTTPStatus.OK, pose.to_dict()
    return HTTPStatus.BAD_REQUEST, {"error": "ask for /TARGET/SOURCE"}


async def serve(buffer: Buffer, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    """One request of one connection."""
    try:
        async with asyncio.timeout(10.0):
            head = await reader.readuntil(b"\r\n\r\n")
            status, found = await find(buffer, head.partition(b"\r\n")[0].decode("latin-1"))
            body = json.dumps(found).encode() + b"\n"
            lines = [
                f"HTTP/1.1 {status.value} {status.phrase}",
                "Content-Type: application/json",
                f"Content-Length: {len(body)}",
                "Connection: close",
            ]
            writer.write("\r\n".join([*lines, "", ""]).encode() + body)
            await writer.drain()
    except (OSError, EOFError, asyncio.LimitOverrunError):
        pass  # a client that is slow, gone, or does not speak HTTP
    finally:
        writer.close()


async def main() -> None:
    buffer = Buffer()
    with Node.from_args("http_service") as node, TransformListener(buffer, node):
        port = node.declare_parameter("port", 8000, minimum=0, maximum=65535).value
        try:
            server = await asyncio.start_server(partial(serve, buffer), "127.0.0.1", port)
        except OSError as error:  # as of a port that is in use
            raise SystemExit(f"Error: {error}") from None
        print(f"http://127.0.0.1:{server.sockets[0].getsockname()[1]}/TARGET/SOURCE", flush=True)
        ended = asyncio.Event()
        # KeyboardInterrupt could strike in the middle of a request, which asyncio would print.
        asyncio.get_running_loop().add_signal_handler(signal.SIGINT, ended.set)
        async with server:
            await ended.wait()


if __name__ == "__main__":
    with suppress(KeyboardInterrupt):
        asyncio.run(main())
