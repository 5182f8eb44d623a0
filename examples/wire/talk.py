"""Publishes a dynamic and a static frame without tfbus, as one of tfbus's own nodes does.

    python examples/wire/talk.py
    python examples/wire/talk.py NAME

`tfbus frames`, `tfbus echo world talk_camera` and listen.py show them. NAME is that of the node,
its stream and its frames, by default `talk`. Ctrl-C ends it. Needs eclipse-zenoh and msgpack only;
each comment names a section of docs/reference/wire.md.
"""

import math
import os
import socket
import sys
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress

import msgpack
from tfbus_wire import Description, chunk, encode_description, encode_transforms, open_session
from zenoh import CongestionControl, Priority, Query, Queryable, Session, ext

PERIOD_S = 0.05
HISTORY_S = 5.0
HISTORY_BYTES = 16 * 1024 * 1024

Kept = deque[tuple[float, bytes]]  # when it was sent, by time.monotonic(), and the payload


def main() -> None:
    name = sys.argv[1] if len(sys.argv) > 1 else "talk"
    with suppress(KeyboardInterrupt), open_session() as session:
        publish(session, name)


def publish(session: Session, name: str) -> None:
    # Epochs: the first is when the node started
    started_ns = time.time_ns()
    tf, tf_static = f"tf/{chunk(name)}", f"tf_static/{chunk(name)}"
    stream_key, node_key = f"@tfbus/stream/{chunk(name)}", f"@tfbus/node/{chunk(name)}"

    # Streams and nodes
    description = Description(
        node=f"/{name}",
        epoch=started_ns,
        frames=[("world", name, False), (name, f"{name}_camera", True)],
        host=socket.gethostname(),
        pid=os.getpid(),
        session=str(session.info.zid()),
        history_s=HISTORY_S,
        started_ns=started_ns,
    )
    node = {
        "name": description.node,
        "host": description.host,
        "pid": description.pid,
        "version": "talk.py",
        "session": description.session,
        "started_ns": started_ns,
        "streams": [name],
        "unread": [],
        "buffers": [],
        "publishes": {},
        "subscribes": {},
        "serves": {},
        "calls": {},
        "parameters": [],
    }

    def clock() -> bytes:
        payload: bytes = msgpack.packb({"now": time.time_ns()})
        return payload

    # What is declared lives for as long as its variable.
    declared = [
        answer(session, node_key, lambda: msgpack.packb(node)),
        answer(session, f"@tfbus/clock/{chunk(name)}", clock),
        session.liveliness().declare_token(node_key),
    ]

    descriptions = retained(session, stream_key)
    descriptions.put(encode_description(description))
    declared.append(session.liveliness().declare_token(stream_key))

    # A message of transforms: on tf_static each one holds all static transforms of the stream
    camera = (0.1, 0.0, 0.3, 0.0, 0.0, 0.0, 1.0)
    static = encode_transforms(started_ns, 0, [(name, f"{name}_camera", started_ns, camera)])
    statics = retained(session, tf_static)
    statics.put(static)
    declared.append(answer(session, tf_static, lambda: static))

    # History
    kept: Kept = deque()
    declared.append(session.declare_queryable(tf, lambda query: answer_history(query, tf, kept)))

    # How messages are sent
    dynamic = session.declare_publisher(
        tf, congestion_control=CongestionControl.DROP, priority=Priority.INTERACTIVE_HIGH
    )
    print(f"{name}: publishing world -> {name} -> {name}_camera", flush=True)
    seq = 0
    while declared:
        now_ns = time.time_ns()
        angle = now_ns / 1e9 % math.tau
        pose = (math.cos(angle), math.sin(angle), 0.0)
        turn = (0.0, 0.0, math.sin(angle / 2), math.cos(angle / 2))
        payload = encode_transforms(started_ns, seq, [("world", name, now_ns, pose + turn)])
        dynamic.put(payload)
        keep(kept, payload)
        seq += 1
        time.sleep(PERIOD_S)


def retained(session: Session, key: str) -> ext.AdvancedPublisher:
    """A publisher whose last message reaches those who come later (How messages are sent)."""
    return ext.declare_advanced_publisher(
        session,
        key,
        congestion_control=CongestionControl.BLOCK,
        priority=Priority.INTERACTIVE_HIGH,
        cache=ext.CacheConfig(max_samples=1),
        publisher_detection=True,
        sample_miss_detection=ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=0.5),
    )


def answer(session: Session, key: str, payload: Callable[[], bytes]) -> Queryable[None]:
    """A queryable whose only answer is what `payload` returns at the time."""
    return session.declare_queryable(key, lambda query: query.reply(key, payload()))


def keep(kept: Kept, payload: bytes) -> None:
    """Keep a message for as long as the description says."""
    kept.append((time.monotonic(), payload))
    while kept[0][0] < time.monotonic() - HISTORY_S or sum_of(kept) > HISTORY_BYTES:
        kept.popleft()


def sum_of(kept: Kept) -> int:
    return sum(len(payload) for _, payload in kept)


def answer_history(query: Query, key: str, kept: Kept) -> None:
    """Reply with the messages that were sent in the last `last_s` seconds, oldest first."""
    text = query.parameters.get("last_s")
    try:
        last_s = HISTORY_S if text is None else float(text)
    except ValueError:
        last_s = -1.0
    if not last_s >= 0.0:
        query.reply_err(f"last_s is {text!r}: give seconds, as in last_s=2.5")
        return
    for sent_s, payload in list(kept):
        if sent_s >= time.monotonic() - last_s:
            query.reply(key, payload)


if __name__ == "__main__":
    main()
