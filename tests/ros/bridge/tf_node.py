"""A node of the ROS in memory that broadcasts and listens as tf2_ros does."""

from dataclasses import replace

from tests.ros.bridge.fake_leg import FakeLeg, FakeRos
from tfbus import TransformStamped
from tfbus.geometry.columns import Columns
from tfbus.ros.bridge.legs import LegSettings, RosTopic
from tfbus.ros.definitions import TF_MESSAGE
from tfbus.ros.tf_message import TFMessageReader, TFMessageWriter

TF = RosTopic("/tf", TF_MESSAGE)
TF_STATIC = RosTopic("/tf_static", TF_MESSAGE, retained=True, depth=1)


class TfNode:
    """Broadcasts, dynamic and static, and hears both; `namespace` is that of its topics too."""

    def __init__(self, ros: FakeRos, name: str, namespace: str = "") -> None:
        self.leg: FakeLeg = ros.leg(LegSettings(name, namespace))
        prefix = f"/{namespace}" if namespace else ""
        dynamic = replace(TF, name=f"{prefix}/tf")
        static = replace(TF_STATIC, name=f"{prefix}/tf_static")
        self.tf = self.leg.publisher(dynamic)
        self.tf_static = self.leg.publisher(static)
        # All that came, in order, and the messages they came in.
        self.heard: list[TransformStamped] = []
        self.messages: list[list[TransformStamped]] = []
        self.static_messages: list[list[TransformStamped]] = []
        # What tf2's buffer would hold.
        self.statics: dict[str, TransformStamped] = {}
        self._sent_statics: dict[str, TransformStamped] = {}
        self._reader, self._writer = TFMessageReader(), TFMessageWriter()
        self.leg.subscribe(dynamic, self._on_tf)
        self.leg.subscribe(replace(static, depth=100), self._on_static)

    def broadcast(self, *transforms: TransformStamped) -> None:
        """Send dynamic transforms in one message."""
        self.tf.send(self._writer.write(Columns.of_transforms(transforms)))

    def broadcast_static(self, *transforms: TransformStamped) -> None:
        """Send static transforms and all those before."""
        self._sent_statics |= {each.child_frame_id: each for each in transforms}
        rows = Columns.of_transforms(self._sent_statics.values())
        self.tf_static.send(self._writer.write(rows))

    def frames_heard(self) -> set[str]:
        """The child frames of dynamic transforms."""
        return {each.child_frame_id for each in self.heard}

    def close(self) -> None:
        """It dies."""
        self.leg.close()

    def _on_tf(self, payload: bytes, gid: str) -> None:
        transforms = list(self._reader.read(payload))
        self.messages.append(transforms)
        self.heard += transforms

    def _on_static(self, payload: bytes, gid: str) -> None:
        transforms = list(self._reader.read(payload))
        self.static_messages.append(transforms)
        self.statics |= {each.child_frame_id: each for each in transforms}
