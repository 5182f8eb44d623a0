"""A peer without tfbus, in plain Zenoh: sends a release's messages, and prints received ones.

    python plain_peer.py FROZEN.json CONFIG ENDPOINT

Any Python with eclipse-zenoh and msgpack runs it: `make release-check` does with older ones.
"""

import json
import sys
import time
from importlib import metadata

import msgpack
import zenoh
from zenoh import ext

with open(sys.argv[1]) as file:
    FROZEN = json.load(file)
DESCRIPTION = bytes.fromhex(FROZEN["descriptions"]["StreamDescription"])


def opened() -> zenoh.Session:
    """A session of the id that the frozen description names: listeners hold against others."""
    config = zenoh.Config.from_file(sys.argv[2])
    config.insert_json5("id", json.dumps(msgpack.unpackb(DESCRIPTION)["session"]))
    config.insert_json5("connect/endpoints", json.dumps([sys.argv[3]]))
    return zenoh.open(config)


def retain(session: zenoh.Session, key: str, payload: bytes) -> object:
    """As docs/reference/wire.md says; the publisher, which lives as long as it is held."""
    publisher = ext.declare_advanced_publisher(
        session,
        key,
        cache=ext.CacheConfig(max_samples=1),
        sample_miss_detection=ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=0.5),
        publisher_detection=True,
    )
    publisher.put(payload)
    return publisher


def say(what: str, key: object, text: object = "") -> None:
    """A line for the test, in one piece: threads of Zenoh's say something at the same time."""
    print(f"{what} {key} {text}\n", end="", flush=True)


def main() -> None:
    """Send a stream and serve a service until it is killed."""
    transforms = {name: bytes.fromhex(text) for name, text in FROZEN["transforms"].items()}
    answer = bytes.fromhex(FROZEN["messages"]["Spawn.Response"])
    said = set()

    def on_sample(sample: zenoh.Sample) -> None:
        if str(sample.key_expr) not in said:
            said.add(str(sample.key_expr))
            say("received", sample.key_expr, msgpack.unpackb(sample.payload.to_bytes())["frames"])

    def on_query(query: zenoh.Query) -> None:
        say("asked", query.key_expr, msgpack.unpackb(query.payload.to_bytes()))
        query.reply(query.key_expr, answer)

    with opened() as session:
        # Each lives as long as it is held.
        _held = [
            session.declare_subscriber("tf/**", on_sample),
            ext.declare_advanced_subscriber(
                session,
                "tf_static/**",
                on_sample,
                history=ext.HistoryConfig(detect_late_publishers=True, max_samples=1),
                recovery=ext.RecoveryConfig(periodic_queries=None, heartbeat=True),
            ),
            session.liveliness().declare_subscriber(
                "@tfbus/stream/*",
                lambda sample: say("token", sample.key_expr, sample.kind),
                history=True,
            ),
            session.declare_queryable("spawn", on_query),
            retain(session, "tf_static/sim", transforms["static"]),
            retain(session, "@tfbus/stream/sim", DESCRIPTION),
            session.liveliness().declare_token("@tfbus/stream/sim"),
        ]
        say("ready", "eclipse-zenoh", metadata.version("eclipse-zenoh"))
        while True:
            session.put("tf/sim", transforms["dynamic"])
            time.sleep(0.1)


if __name__ == "__main__":
    main()
