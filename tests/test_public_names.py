"""The public names, on which other packages may rely."""

import importlib
import importlib.metadata
import inspect
import pkgutil
import subprocess
import sys

import pytest

import tfbus
import tfbus.compat
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
    "GapException",
    "GoalHandle",
    "GoalResult",
    "InvalidArgumentException",
    "InvalidNameError",
    "Joint",
    "Limits",
    "Link",
    "LookupException",
    "LoopException",
    "MutuallyExclusiveCallbackGroup",
    "NoDataException",
    "Node",
    "NodeName",
    "NodeSettings",
    "Number",
    "Parameter",
    "ParameterError",
    "PastExtrapolationException",
    "ReentrantCallbackGroup",
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
    "FileError",
    "MissingFileError",
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
    "Pose3D",
    "PoseStamped",
    "PoseWithCovariance",
    "Quaternion",
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
    "TwistWithCovariance",
    "Vector3",
]

# Public functions, by their modules.
FUNCTIONS = {
    "buffer.files": "load save",
    "buffer.formats": "as_dot as_html as_svg as_text as_yaml show",
    "buffer.trajectories": "insert insert_csv insert_tum samples trajectory",
    "sensor_files": "read_cloud",
}
INSPECT = [
    "BusChange",
    "BusMoment",
    "Endpoint",
    "FrameStatus",
    "NodeDescription",
    "Problem",
    "Recorded",
    "ServiceInfo",
    "StreamInfo",
    "TopicInfo",
    "Watch",
]

# The modules with ROS's names, and those that each has.
COMPAT = {
    "rclpy": (
        "Parameter callback_groups clock constants create_node duration exceptions "
        "executors get_default_context init logging node ok parameter qos shutdown spin "
        "spin_once spin_until_future_complete task time try_shutdown utilities"
    ),
    "rclpy.callback_groups": (
        "CallbackGroup MutuallyExclusiveCallbackGroup ReentrantCallbackGroup"
    ),
    "rclpy.clock": "Clock ClockType ROSClock",
    "rclpy.context": "Context",
    "rclpy.duration": "Duration Infinite",
    "rclpy.exceptions": (
        "InvalidHandle InvalidParameterTypeException InvalidParameterValueException "
        "NotInitializedException ParameterAlreadyDeclaredException "
        "ParameterNotDeclaredException ParameterUninitializedException"
    ),
    "rclpy.executors": (
        "Executor ExternalShutdownException MultiThreadedExecutor SingleThreadedExecutor"
    ),
    "rclpy.logging": (
        "LoggingSeverity RcutilsLogger get_logger get_logging_severity_from_string set_logger_level"
    ),
    "rclpy.node": (
        "Client Node Parameter ParameterDescriptor ParameterType Publisher Service "
        "SetParametersResult Subscription Timer"
    ),
    "rclpy.parameter": "Parameter ParameterValue",
    "rclpy.qos": (
        "DurabilityPolicy HistoryPolicy LivelinessPolicy QoSDurabilityPolicy "
        "QoSHistoryPolicy QoSLivelinessPolicy QoSPresetProfiles QoSProfile "
        "QoSReliabilityPolicy ReliabilityPolicy qos_profile_action_status_default "
        "qos_profile_parameter_events qos_profile_parameters qos_profile_sensor_data "
        "qos_profile_services_default qos_profile_system_default qos_profile_unknown"
    ),
    "rclpy.task": "Future",
    "rclpy.time": "ClockType Duration Time",
    "rclpy.type_support": (
        "Action ActionT FeedbackMessage FeedbackT GetResultServiceResponse GoalT Msg MsgT ResultT "
        "SendGoalServiceResponse Srv SrvRequestT SrvResponseT SrvT"
    ),
    "rclpy.utilities": ("get_default_context ok remove_ros_args"),
    "tf2_geometry_msgs": (
        "do_transform_point do_transform_polygon_stamped do_transform_pose "
        "do_transform_pose_stamped do_transform_pose_with_covariance_stamped "
        "do_transform_vector3 from_msg_msg to_msg_msg transform_covariance"
    ),
    "rclpy.action": ("ActionClient ActionServer CancelResponse GoalResponse"),
    "rclpy.action.client": ("ActionClient ClientGoalHandle"),
    "rclpy.action.server": (
        "ActionServer CancelResponse GoalResponse ServerGoalHandle default_cancel_callback "
        "default_goal_callback default_handle_accepted_callback"
    ),
    "rclpy.constants": ("S_TO_NS"),
    "rclpy.lifecycle": (
        "LifecycleNode LifecyclePublisher LifecycleState ManagedEntity State "
        "TransitionCallbackReturn"
    ),
    "rclpy.serialization": ("deserialize_message serialize_message"),
    "rclpy.wait_for_message": ("wait_for_message"),
    "message_filters": (
        "ApproximateTimeSynchronizer Cache SimpleFilter Subscriber TimeSynchronizer"
    ),
    "rosidl_runtime_py": (
        "get_message_slot_types message_to_csv message_to_ordereddict message_to_yaml "
        "set_message_fields"
    ),
    "rosidl_runtime_py.convert": (
        "get_message_slot_types message_to_csv message_to_ordereddict message_to_yaml"
    ),
    "rosidl_runtime_py.set_message": ("set_message_fields"),
    "rosidl_runtime_py.utilities": ("get_action get_interface get_message get_service"),
    "sensor_msgs_py": ("point_cloud2"),
    "sensor_msgs_py.point_cloud2": (
        "create_cloud create_cloud_xyz32 dtype_from_fields read_points read_points_list "
        "read_points_numpy"
    ),
    "tf2_sensor_msgs": ("do_transform_cloud from_msg_msg to_msg_msg transform_points"),
    "tf_transformations": (
        "clip_matrix compose_matrix concatenate_matrices decompose_matrix euler_from_matrix "
        "euler_from_quaternion euler_matrix identity_matrix inverse_matrix "
        "is_same_transform orthogonalization_matrix projection_from_matrix "
        "projection_matrix quaternion_about_axis quaternion_conjugate quaternion_from_euler "
        "quaternion_from_matrix quaternion_inverse quaternion_matrix quaternion_multiply "
        "quaternion_slerp random_quaternion random_rotation_matrix random_vector "
        "reflection_from_matrix reflection_matrix rotation_from_matrix rotation_matrix "
        "scale_from_matrix scale_matrix shear_from_matrix shear_matrix "
        "superimposition_matrix translation_from_matrix translation_matrix unit_vector "
        "vector_norm"
    ),
    "tf2_py": (
        "BufferCore ConnectivityException ExtrapolationException InvalidArgumentException "
        "LookupException TimeoutException TransformException"
    ),
    "tf2_ros": (
        "Buffer BufferCore BufferInterface ConnectivityException ConvertRegistration "
        "Duration ExtrapolationException Header InvalidArgumentException LookupException "
        "NotImplementedException Stamped StaticTransformBroadcaster TFMessage Time "
        "TimeoutException TransformBroadcaster TransformException TransformListener "
        "TransformRegistration TransformStamped TypeException convert"
    ),
    "tf2_ros.buffer": "Buffer",
    "tf2_ros.buffer_interface": (
        "BufferInterface ConvertRegistration NotImplementedException Stamped "
        "TransformRegistration TypeException convert"
    ),
    "tf2_ros.static_transform_broadcaster": "StaticTransformBroadcaster",
    "tf2_ros.transform_broadcaster": "TransformBroadcaster",
    "tf2_ros.transform_listener": ("DEFAULT_STATIC_TF_TOPIC DEFAULT_TF_TOPIC TransformListener"),
}


def test_the_public_names_are_these() -> None:
    """A name is added to or taken from `tfbus` here and nowhere by accident."""
    assert sorted(NAMES) == tfbus.__all__ == dir(tfbus)


def test_the_messages_are_these() -> None:
    """A message, service or action is added to or taken from `tfbus.messages` here too; a type
    that is on the bus as in ROS stands in tests/test_types_of_ros.py.
    """
    defined = [
        name
        for name, value in vars(messages).items()
        if inspect.isclass(value)
        and value.__module__.startswith("tfbus.messages")
        and not hasattr(value, "__msgtype__")
    ]
    assert sorted(MESSAGES) == sorted(name for name in defined if not name.startswith("_"))


def test_a_buffer_has_room_for_lookups_only() -> None:
    """At most 35 public methods: files, trajectories and dumps are functions on it."""
    names = [name for name in dir(tfbus.Buffer) if not name.startswith("_")]
    assert len([name for name in names if callable(getattr(tfbus.Buffer, name))]) <= 35


def test_functions_of_other_modules_are_these() -> None:
    """Each has a docstring."""
    for module, functions in FUNCTIONS.items():
        imported = importlib.import_module(f"tfbus.{module}")
        assert all(inspect.getdoc(getattr(imported, name)) for name in functions.split())


def test_every_public_name_is_there() -> None:
    """Each name can be imported, is what it says, and has a docstring."""
    for name in NAMES:
        value = getattr(tfbus, name)
        assert value.__name__ == name
        assert inspect.getdoc(value), name


def test_the_names_of_inspect_are_these() -> None:
    """Each is there and says what it is, without an import of its own; the stdlib's is another."""
    module = tfbus.inspect
    assert sorted(module.__all__) == INSPECT
    assert all(inspect.getdoc(getattr(module, name)) for name in INSPECT)
    assert inspect.__name__ == "inspect"


def test_a_name_that_is_not_public_is_an_attribute_error() -> None:
    """As of any module."""
    with pytest.raises(AttributeError, match=r"'tfbus' .*'nonsense'"):
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


def test_the_ported_names_are_these() -> None:
    """Each is there, and each class and function says its job; no other is public."""
    for module, names in COMPAT.items():
        ported = importlib.import_module(f"tfbus.compat.{module}")
        assert sorted(names.split()) == sorted(ported.__all__)
        for name in ported.__all__:
            value = getattr(ported, name)
            assert not inspect.isclass(value) or inspect.getdoc(value), (module, name)
            assert not inspect.isfunction(value) or inspect.getdoc(value), (module, name)


# Imports each as the first module of a program would.
_EACH_ALONE = """
import importlib, sys
for name in sys.argv[1:]:
    for loaded in [each for each in sys.modules if each.startswith("tfbus.compat")]:
        del sys.modules[loaded]
    importlib.import_module(f"tfbus.compat.{name}")
"""


@pytest.mark.real
def test_each_module_of_ported_names_may_be_imported_first() -> None:
    """No module needs that another one was imported before it."""
    subprocess.run([sys.executable, "-c", _EACH_ALONE, *COMPAT], check=True, timeout=100)


def test_every_module_of_ported_names_is_listed() -> None:
    """A module of ported names is one that lists names."""
    found = {
        name.removeprefix("tfbus.compat.")
        for _, name, _ in pkgutil.walk_packages(tfbus.compat.__path__, "tfbus.compat.")
        if hasattr(importlib.import_module(name), "__all__")
    }
    assert found == set(COMPAT)
