"""A node of pyzeros, an implementation of rmw_zenoh's wire: it publishes and hears /tf.

Run by the Python of its environment: rmw_pyzeros.py ENDPOINT CONFIG. It prints received messages.
"""

import asyncio
import json
import sys
from dataclasses import dataclass, field
from pathlib import Path

import pyzeros
import zenoh
from pyzeros.qos import QosProfile
from ros2_pyterfaces.cyclone.all_msgs import Header, Time, TransformStamped
from ros2_pyterfaces.cyclone.idl import IdlStruct, types


@dataclass
class TFMessage(IdlStruct, typename="tf2_msgs/msg/TFMessage"):
    """tf2_msgs is not among its messages."""

    transforms: types.sequence[TransformStamped] = field(default_factory=list)


async def main() -> None:
    """Publish and hear until the end of the process."""
    qos = QosProfile(depth=100)
    publisher = pyzeros.Pub(TFMessage, "/tf", qos)
    subscriber = pyzeros.Sub(TFMessage, "/tf", qos)

    async def publish() -> None:
        transform = TransformStamped(Header(Time(12, 34), "base"), "pyzeros_arm")
        transform.transform.translation.x = 1.5
        while True:
            publisher.publish(TFMessage([transform]))
            await asyncio.sleep(0.1)

    async def hear() -> None:
        async for message in subscriber.listen_reliable():
            for each in message.transforms:
                if each.child_frame_id != "pyzeros_arm":
                    print("heard", each.child_frame_id, each.transform.translation.x, flush=True)

    print("gid", bytes(publisher.gid).hex(), flush=True)
    print("token", publisher.token_keyexpr, flush=True)
    await asyncio.gather(publish(), hear())


endpoint, config_file = sys.argv[1:]
config = zenoh.Config.from_file(str(Path(config_file)))
config.insert_json5("connect/endpoints", json.dumps([endpoint]))
with pyzeros.auto_context("pyzeros_node", zenoh.open(config), namespace="/robot1"):
    asyncio.run(main())
