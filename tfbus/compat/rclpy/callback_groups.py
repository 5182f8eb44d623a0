"""ROS's rclpy.callback_groups: accepted, as callbacks run one at a time whatever their group."""

__all__ = ["CallbackGroup", "MutuallyExclusiveCallbackGroup", "ReentrantCallbackGroup"]


class CallbackGroup:
    """A group of callbacks."""


class MutuallyExclusiveCallbackGroup(CallbackGroup):
    """A group of callbacks that run one at a time, as all do."""


class ReentrantCallbackGroup(CallbackGroup):
    """A group of callbacks that may run at once in ROS; here they run one at a time."""
