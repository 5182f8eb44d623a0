"""An attacker on a closed bus, by Zenoh alone: it obeys no rights.

closed_bus_attacker.py FOLDER GETS [ROUTER]: it takes the certificate in FOLDER, or "tcp" for none,
sends all that a robot could, and prints the messages that it has read, with their senders, as JSON.
It goes on until it has the things of GETS: "links", "transforms" or "nothing", for which it tries
some seconds.
"""

import json
import sys
import threading
import time
from pathlib import Path

import msgpack
import zenoh

SENDS_S = 1.5
FINDS_WITHIN_S = 2.5

KEYS = (
    "tf/robot",
    "tf/turtle1_broadcaster",
    "tf_static/robot",
    "@tfbus/stream/robot",
    "@tfbus/node/sim",
    "@tfbus/node/robot",
    "clock",
    "*",
    "**",
    "*/robot",
)
QUESTIONS = ("@tfbus/set/sim/background_r", "**/@tfbus/set/**", "@/**")


def configuration(folder: Path, router: str) -> zenoh.Config:
    """Peers, or a client of a router, by the certificate in a folder."""
    settings: dict[str, object] = {"scouting/delay": 300, "timestamping/enabled": True}
    if str(folder) == "tcp":
        settings["transport/link/protocols"] = ["tcp", "udp"]
        router = router.replace("tls/", "tcp/")
    else:
        settings["transport/link/protocols"] = ["tls"]
        settings["listen/endpoints"] = ["tls/[::]:0"]
        sides = {
            f"{side}_{what}": str(folder / file)
            for side in ("listen", "connect")
            for what, file in (("certificate", "certificate.pem"), ("private_key", "key.pem"))
        }
        settings["transport/link/tls"] = {
            "root_ca_certificate": str(folder / "authority.pem"),
            "enable_mtls": True,
            "verify_name_on_connect": False,
            **sides,
        }
    if router:
        also_udp = [router.replace("tcp/", "udp/")] if router.startswith("tcp/") else []
        settings["connect/endpoints"] = [router, *also_udp]
        settings["connect/exit_on_failure"] = False
        settings["connect/timeout_ms"] = 0
    config = zenoh.Config()
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    return config


def is_transform(key: str) -> bool:
    """Whether dynamic transforms are sent at this key."""
    return key.startswith("tf/")


def main(folder: Path, gets: str, router: str) -> None:
    """Attack, then print what came of it."""
    session = zenoh.open(configuration(folder, router))
    own = str(session.zid())
    # Zenoh's threads add to it.
    read: list[str] = []
    forged = msgpack.packb([[0, "world", "forged", 9.0, 9.0, 9.0, 0.0, 0.0, 0.0, 1.0]])

    def note(sample: zenoh.Sample) -> None:
        if sample.payload.to_bytes() != forged:
            read.append(str(sample.key_expr))

    for expression in ("**", "**/@tfbus/**"):
        session.declare_subscriber(expression, note)
    deadline = time.monotonic() + FINDS_WITHIN_S
    links: list[str] = []
    while not links and (gets != "nothing" or time.monotonic() < deadline):
        links = [*map(str, session.info.peers_zid()), *map(str, session.info.routers_zid())]
        threading.Event().wait(0.02)
    for key in ("turtle1/teleport_absolute", "reset", *KEYS):
        session.liveliness().declare_token(key)
        session.declare_queryable(key, lambda query: query.drop())
    ends = time.monotonic() + (SENDS_S if links else 0.3)
    while time.monotonic() < ends or (gets == "transforms" and not any(map(is_transform, read))):
        for key in KEYS:
            session.put(key, forged)
        threading.Event().wait(0.05)
    answers = [
        str(reply.ok.key_expr)
        for key in QUESTIONS
        for reply in session.get(key, payload=msgpack.packb({"value": 3}), timeout=0.5)
        if reply.ok and own not in str(reply.ok.key_expr)
    ]
    print(json.dumps({"links": links, "read": sorted({*read}), "answers": answers}), flush=True)
    session.close()


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2], sys.argv[3] if len(sys.argv) > 3 else "")
