"""A router of Zenoh without tfbus, on ENDPOINT; of any version, as plain_peer.py."""

import json
import sys
import threading
from importlib import metadata

import zenoh

config = zenoh.Config()
config.insert_json5("mode", '"router"')
config.insert_json5("listen/endpoints", json.dumps([sys.argv[1]]))
config.insert_json5("scouting/multicast/enabled", "false")
config.insert_json5("timestamping/enabled", "true")
with zenoh.open(config):
    print("ready eclipse-zenoh", metadata.version("eclipse-zenoh"), flush=True)
    threading.Event().wait()
