"""ROS's rclpy.lifecycle: nodes that are configured and activated from outside, by their services
change_state and get_state.
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from functools import wraps
from typing import Any, NamedTuple

from tfbus.compat.rclpy.endpoints import Publisher
from tfbus.compat.rclpy.node import Node
from tfbus.ros.message_classes import interface_class, message_class

__all__ = [
    "LifecycleNode",
    "LifecyclePublisher",
    "LifecycleState",
    "ManagedEntity",
    "State",
    "TransitionCallbackReturn",
]

_State: Any = message_class("lifecycle_msgs/msg/State")
_Transition: Any = message_class("lifecycle_msgs/msg/Transition")
_ChangeState: Any = interface_class("lifecycle_msgs/srv/ChangeState")
_GetState: Any = interface_class("lifecycle_msgs/srv/GetState")
_GetAvailableTransitions: Any = interface_class("lifecycle_msgs/srv/GetAvailableTransitions")
_Description: Any = message_class("lifecycle_msgs/msg/TransitionDescription")


class TransitionCallbackReturn(IntEnum):
    """How a transition went."""

    SUCCESS = _Transition.TRANSITION_CALLBACK_SUCCESS
    FAILURE = _Transition.TRANSITION_CALLBACK_FAILURE
    ERROR = _Transition.TRANSITION_CALLBACK_ERROR


class LifecycleState(NamedTuple):
    """A state, by its number and name."""

    label: str
    state_id: int


State = LifecycleState


def _state(name: str) -> LifecycleState:
    return LifecycleState(name, getattr(_State, f"PRIMARY_STATE_{name.upper()}"))


_UNCONFIGURED, _INACTIVE, _ACTIVE, _FINALIZED = (
    _state(name) for name in ("unconfigured", "inactive", "active", "finalized")
)


@dataclass(frozen=True)
class _StateChange:
    """A transition: its number, from which states, to which, and the callback."""

    id: int
    begin: tuple[LifecycleState, ...]
    end: LifecycleState
    callback: str


_STEPS = {
    "configure": _StateChange(
        _Transition.TRANSITION_CONFIGURE, (_UNCONFIGURED,), _INACTIVE, "on_configure"
    ),
    "cleanup": _StateChange(
        _Transition.TRANSITION_CLEANUP, (_INACTIVE,), _UNCONFIGURED, "on_cleanup"
    ),
    "activate": _StateChange(_Transition.TRANSITION_ACTIVATE, (_INACTIVE,), _ACTIVE, "on_activate"),
    "deactivate": _StateChange(
        _Transition.TRANSITION_DEACTIVATE, (_ACTIVE,), _INACTIVE, "on_deactivate"
    ),
    "shutdown": _StateChange(
        _Transition.TRANSITION_UNCONFIGURED_SHUTDOWN,
        (_UNCONFIGURED, _INACTIVE, _ACTIVE),
        _FINALIZED,
        "on_shutdown",
    ),
}

# ROS has a number for the shutdown from each state.
_SHUTDOWNS = (
    _Transition.TRANSITION_INACTIVE_SHUTDOWN,
    _Transition.TRANSITION_ACTIVE_SHUTDOWN,
)


class ManagedEntity:
    """A part that is switched on and off with its node."""

    def __init__(self) -> None:
        self._enabled = False

    @property
    def is_activated(self) -> bool:
        """Whether its node is active."""
        return self._enabled

    def on_activate(self, state: LifecycleState | None = None) -> TransitionCallbackReturn:
        """Switch it on."""
        self._enabled = True
        return TransitionCallbackReturn.SUCCESS

    def on_deactivate(self, state: LifecycleState | None = None) -> TransitionCallbackReturn:
        """Switch it off."""
        self._enabled = False
        return TransitionCallbackReturn.SUCCESS

    @staticmethod
    def when_enabled(function: Callable[..., Any]) -> Callable[..., Any]:
        """A method that does nothing while its node is not active."""

        @wraps(function)
        def wrapped(self: "ManagedEntity", *arguments: Any, **named: Any) -> Any:
            return function(self, *arguments, **named) if self._enabled else None

        return wrapped


class LifecyclePublisher(ManagedEntity):
    """A publisher that sends while its node is active."""

    def __init__(self, publisher: Publisher) -> None:
        super().__init__()
        self.publisher = publisher
        self.topic_name = publisher.topic_name

    def publish(self, msg: Any) -> None:
        """Send a message; nothing while the node is not active."""
        if self._enabled:
            self.publisher.publish(msg)

    def destroy(self) -> None:
        """End it."""
        self.publisher.destroy()


class LifecycleNode(Node):
    """A node with states: override `on_configure(state)`, `on_activate(state)` and so on.

    Its services ~/change_state and ~/get_state serve its managers, and `trigger_configure()` and so
    on itself.
    """

    def __init__(self, node_name: str, **options: Any) -> None:
        self._state = _UNCONFIGURED
        self._managed: list[LifecyclePublisher] = []
        options.pop("enable_communication_interface", None)
        super().__init__(node_name, **options)
        self.create_service(_ChangeState, "~/change_state", self._on_change_state)
        self.create_service(_GetState, "~/get_state", self._on_get_state)
        self.create_service(
            _GetAvailableTransitions, "~/get_available_transitions", self._on_get_transitions
        )

    def create_lifecycle_publisher(self, *arguments: Any, **named: Any) -> LifecyclePublisher:
        """A publisher that sends while the node is active; arguments as of `create_publisher`."""
        made = LifecyclePublisher(self.create_publisher(*arguments, **named))
        self._managed.append(made)
        return made

    def destroy_lifecycle_publisher(self, publisher: LifecyclePublisher) -> bool:
        """End it."""
        publisher.destroy()
        return True

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Called on the way from unconfigured to inactive."""
        return TransitionCallbackReturn.SUCCESS

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Called on the way back to unconfigured."""
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Called on the way from inactive to active; switches the publishers on."""
        for each in self._managed:
            each.on_activate(state)
        return TransitionCallbackReturn.SUCCESS

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Called on the way back to inactive; switches the publishers off."""
        for each in self._managed:
            each.on_deactivate(state)
        return TransitionCallbackReturn.SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Called on the way to the end."""
        return TransitionCallbackReturn.SUCCESS

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Called if one of the others fails: SUCCESS makes it unconfigured, else it ends."""
        return TransitionCallbackReturn.FAILURE

    def trigger_configure(self) -> TransitionCallbackReturn:
        """Configure it. Raises RuntimeError in a state in which it cannot be."""
        return self._go("configure")

    def trigger_cleanup(self) -> TransitionCallbackReturn:
        """Make it unconfigured; raises as `trigger_configure`."""
        return self._go("cleanup")

    def trigger_activate(self) -> TransitionCallbackReturn:
        """Activate it; raises as `trigger_configure`."""
        return self._go("activate")

    def trigger_deactivate(self) -> TransitionCallbackReturn:
        """Deactivate it; raises as `trigger_configure`."""
        return self._go("deactivate")

    def trigger_shutdown(self) -> TransitionCallbackReturn:
        """End it; raises as `trigger_configure`."""
        return self._go("shutdown")

    def _go(self, name: str) -> TransitionCallbackReturn:
        step = _STEPS[name]
        if self._state not in step.begin:
            raise RuntimeError(
                f"{self.get_name()} is {self._state.label}: {name} is not possible, but "
                f"{', '.join(self._possible()) or 'nothing'}"
            )
        try:
            answer = getattr(self, step.callback)(self._state)
        except Exception as error:
            self.get_logger().error(f"{step.callback} failed: {type(error).__name__}: {error}")
            answer = TransitionCallbackReturn.ERROR
        if answer == TransitionCallbackReturn.SUCCESS:
            self._state = step.end
        elif answer == TransitionCallbackReturn.ERROR:
            is_mended = self.on_error(self._state) == TransitionCallbackReturn.SUCCESS
            self._state = _UNCONFIGURED if is_mended else _FINALIZED
        return TransitionCallbackReturn(answer)

    def _possible(self) -> list[str]:
        return [name for name, step in _STEPS.items() if self._state in step.begin]

    def _on_change_state(self, request: Any, response: Any) -> Any:
        wanted = request.transition
        for name in self._possible():
            is_shutdown = name == "shutdown" and wanted.id in _SHUTDOWNS
            if name == wanted.label or wanted.id == _STEPS[name].id or is_shutdown:
                response.success = self._go(name) == TransitionCallbackReturn.SUCCESS
                break
        return response

    def _on_get_state(self, request: Any, response: Any) -> Any:
        response.current_state = _message(self._state)
        return response

    def _on_get_transitions(self, request: Any, response: Any) -> Any:
        response.available_transitions = [
            _Description(
                transition=_Transition(id=_STEPS[name].id, label=name),
                start_state=_message(self._state),
                goal_state=_message(_STEPS[name].end),
            )
            for name in self._possible()
        ]
        return response


def _message(state: LifecycleState) -> Any:
    return _State(id=state.state_id, label=state.label)
