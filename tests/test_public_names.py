"""The public names: what other packages may rely on."""

import importlib.metadata
import inspect

import pytest

import tfbus
from tfbus import messages

NAMES = [
    "Buffer",
    "BusError",
    "Change",
    "ConnectivityException",
    "DecodeError",
    "ExtrapolationException",
    "Fleet",
    "FrameInfo",
    "FrameName",
    "FutureExtrapolationException",
    "GoalHandle",
    "GoalResult",
    "InvalidArgumentException",
    "InvalidNameError",
    "Joint",
    "Limits",
    "Link",
    "LookupException",
    "LoopException",
    "NoDataException",
    "Node",
    "NodeName",
    "NodeSettings",
    "Number",
    "Parameter",
    "ParameterError",
    "PastExtrapolationException",
    "RightsError",
    "Recording",
    "Robot",
    "Sampling",
    "ServiceError",
    "ServiceName",
    "SettingsError",
    "SimulatedClock",
    "SingleSampleException",
    "StaleException",
    "StaticTransformBroadcaster",
    "SystemClock",
    "TfbusError",
    "TimeoutException",
    "TopicName",
    "Trajectory",
    "Transform",
    "TransformArray",
    "TransformBatch",
    "TransformBroadcaster",
    "TransformException",
    "TransformListener",
    "TransformStamped",
    "TwistStamped",
    "UrdfError",
    "fleet_options",
    "node_options",
    "stamp_ns",
]

MESSAGES = [
    "Clock",
    "Color",
    "Empty",
    "Field",
    "JointState",
    "Kill",
    "Odometry",
    "PlayNext",
    "PlayProgress",
    "Pose",
    "PoseStamped",
    "RobotDescription",
    "RobotMesh",
    "RotateAbsolute",
    "SaveRecording",
    "Seek",
    "SetClock",
    "SetDescription",
    "SetPen",
    "SetRate",
    "Spawn",
    "TeleportAbsolute",
    "TeleportRelative",
    "Twist",
    "Vector3",
]


def test_the_public_names_are_these() -> None:
    """A name is added to or taken from `tfbus` here and nowhere by accident."""
    assert sorted(NAMES) == tfbus.__all__ == dir(tfbus)


def test_the_messages_are_these() -> None:
    """A message, service or action is added to or taken from `tfbus.messages` here too."""
    defined = [
        name
        for name, value in vars(messages).items()
        if inspect.isclass(value) and value.__module__ == messages.__name__
    ]
    assert sorted(MESSAGES) == sorted(name for name in defined if not name.startswith("_"))


@pytest.mark.parametrize("name", NAMES)
def test_every_public_name_is_there(name: str) -> None:
    """Each name can be imported, is what it says, and has a docstring."""
    value = getattr(tfbus, name)
    assert value.__name__ == name
    assert inspect.getdoc(value)


def test_a_name_that_is_not_public_is_an_attribute_error() -> None:
    """As of any module."""
    with pytest.raises(AttributeError, match="module 'tfbus' has no attribute 'nonsense'"):
        tfbus.nonsense  # noqa: B018  # the access is the test


def test_the_view_needs_no_import_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    """`tfbus.view.show` is there after `import tfbus`."""
    view = tfbus.view
    monkeypatch.delattr(tfbus, "view")
    assert tfbus.view is view and view.show.__module__ == "tfbus.view.local"


def test_the_version_is_that_of_the_installed_package() -> None:
    """`tfbus.__version__` is there, as of any package, and read only when asked for."""
    assert tfbus.__version__ == importlib.metadata.version("tfbus")
    assert "__version__" in vars(tfbus)


@pytest.mark.parametrize(
    ("name", "ours"), [("init", "Node"), ("spin", r"node\.spin"), ("Time", "stamp_ns")]
)
def test_names_of_rclpy_are_answered_by_ours(name: str, ours: str) -> None:
    """A function of rclpy's module is missing, with a hint."""
    with pytest.raises(AttributeError, match=f"no attribute '{name}'; use: .*{ours}"):
        getattr(tfbus, name)
