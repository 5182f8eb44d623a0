"""A ROS side that is only Zenoh, to be run by another version of it: its router, then its node.

rmw_plain_zenoh.py router ENDPOINT, or rmw_plain_zenoh.py node ENDPOINT with two lines of
hexadecimal digits on its standard input: messages that it publishes, on /tf every 0.1 s, on
/tf_static once, as rmw_zenoh does. It prints received messages. All names are written out here.
"""

import json
import struct
import sys
import time

import zenoh
from zenoh import ext

TYPE = "tf2_msgs::msg::dds_::TFMessage_"
HASH = "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087"
GID = bytes(range(16))

what, endpoint = sys.argv[1:]


def session(mode: str, **values: object) -> zenoh.Session:
    """A session on loopback."""
    config = zenoh.Config()
    config.insert_json5("mode", json.dumps(mode))
    for key, value in values.items():
        config.insert_json5(key.replace("__", "/"), json.dumps(value))
    for key, value in {
        "scouting/multicast/enabled": False,
        "timestamping/enabled": True,
        "transport/link/tx/lease": 60_000,
    }.items():
        config.insert_json5(key, json.dumps(value))
    return zenoh.open(config)


def hear(topic: str, sample: zenoh.Sample) -> None:
    """Print a message."""
    attachment = sample.attachment
    size = 0 if attachment is None else len(attachment.to_bytes())
    print("heard", topic, size, sample.payload.to_bytes().hex(), flush=True)


if what == "router":
    held = session("router", listen__endpoints=[endpoint])
    print("ready", flush=True)
    while True:
        time.sleep(3600)

node = session("peer", connect__endpoints=[endpoint], listen__endpoints=["tcp/127.0.0.1:0"])
zid = str(node.zid())
tokens = [f"@ros2_lv/0/{zid}/0/0/NN/%/%/plain_node"]
for number, (topic, qos) in enumerate((("tf", "::,100:,:,:,,"), ("tf_static", ":1:,1:,:,:,,"))):
    place = f"%/%/plain_node/%{topic}/{TYPE}/{HASH}/{qos}"
    tokens += [f"@ros2_lv/0/{zid}/0/{number + 1}/MP/{place}"]
    tokens += [f"@ros2_lv/0/{zid}/0/{number + 3}/MS/{place}"]
held_tokens = [node.liveliness().declare_token(token) for token in tokens]
remote = zenoh.Locality.REMOTE
held_subscriber = node.declare_subscriber(
    f"0/tf/{TYPE}/{HASH}", lambda sample: hear("/tf", sample), allowed_origin=remote
)
held_late = ext.declare_advanced_subscriber(
    node,
    f"0/tf_static/{TYPE}/{HASH}",
    lambda sample: hear("/tf_static", sample),
    allowed_origin=remote,
    history=ext.HistoryConfig(detect_late_publishers=True, max_samples=100),
    recovery=ext.RecoveryConfig(periodic_queries=None, heartbeat=True),
    subscriber_detection=True,
)
dynamic = node.declare_publisher(
    f"0/tf/{TYPE}/{HASH}", congestion_control=zenoh.CongestionControl.DROP
)
static = ext.declare_advanced_publisher(
    node,
    f"0/tf_static/{TYPE}/{HASH}",
    cache=ext.CacheConfig(max_samples=1),
    sample_miss_detection=ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=0.5),
    publisher_detection=True,
)
of_tf, of_static = (bytes.fromhex(line) for line in sys.stdin.read().split())
static.put(of_static, attachment=struct.pack("<qqB16s", 1, time.time_ns(), 16, GID))
print("ready", zenoh.__version__ if hasattr(zenoh, "__version__") else "", flush=True)
for sequence in range(1, 1_000_000):
    dynamic.put(of_tf, attachment=struct.pack("<qqB16s", sequence, time.time_ns(), 16, GID))
    time.sleep(0.1)
