"""`tfbus call`: call a service or an action from the command line."""

import queue
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import click

from tfbus.base.errors import ServiceError
from tfbus.base.signals import StopSignals
from tfbus.base.wording import did_you_mean
from tfbus.bus.graph import ServiceInfo
from tfbus.bus.query import Answer
from tfbus.bus.session import Session
from tfbus.bus.settings import NodeSettings
from tfbus.cli import Answering
from tfbus.cli.bus import look, look_once, open_bus
from tfbus.cli.message import (
    bare,
    checked_map,
    complete_request,
    complete_values,
    encode_values,
    find_call,
    is_of_type,
    read_map,
    request_of,
    supplied_call,
)
from tfbus.cli.output import print_json
from tfbus.command.options import bus_options
from tfbus.command.types import POSITIVE, ServiceName
from tfbus.wire.codec import decode_map, encode_map
from tfbus.wire.keys import relative

# An action may take any time: only silence ends the wait.
_LONGEST_ACTION_S = 1e6
_CANCEL_TIMEOUT_S = 2.0

TIMEOUT = click.option(
    "--timeout",
    "timeout_s",
    type=POSITIVE,
    default=5.0,
    metavar="S",
    show_default=True,
    help="Fail after this many seconds without an answer or feedback.",
)

_FEEDBACK = "not needed: the feedback of an action is printed"
_FROM_A_SHELL = 'leave it out, and take the request from the shell: "$(cat request.yaml)"'

# Options of `ros2 service call` and `ros2 action send_goal`.
CALLED_IN_ROS = {
    "-r": "tfbus calls once; repeat it in the shell: while sleep 1; do tfbus call ...; done",
    "--rate": "tfbus calls once; repeat it in the shell: while sleep 1; do tfbus call ...; done",
    "-f": _FEEDBACK,
    "--feedback": _FEEDBACK,
    "--stdin": _FROM_A_SHELL,
    "--yaml-file": _FROM_A_SHELL,
}


@click.command(
    cls=Answering,
    hints=CALLED_IN_ROS,
    epilog="Example: tfbus call spawn '{x: 2, y: 3, theta: 0, name: turtle2}'",
)
@click.argument("service", type=ServiceName())
@click.argument("request", nargs=-1, metavar="[TYPE] [REQUEST]", shell_complete=complete_request)
@TIMEOUT
@bus_options("call")
def command(
    settings: NodeSettings, service: str, request: tuple[str, ...], timeout_s: float
) -> None:
    """Call a service or an action, and print its answers.

    REQUEST is a YAML map of fields; missing ones get their defaults, or zeros. TYPE, such as Spawn
    or package.module:Name, is optional; it is an error if the service has another type. Each answer
    is one line of JSON: the response of a service, or the feedback and then the result of an
    action. Ctrl-C cancels an action.
    """
    typed = typed_request(request)
    service = relative(service, settings.namespace)
    with open_bus(settings) as session:
        payload = typed.payload(session, service)
        for answer in follow(session, service, payload, timeout_s):
            print_json(answer)


@dataclass(frozen=True)
class TypedRequest:
    """The typed arguments: the name of a type, "" if it is omitted, and the fields."""

    type_name: str
    values: dict[str, Any]

    def payload(self, session: Session, service: str) -> bytes:
        """The bytes of the request. Raises click.UsageError if the service has another type."""
        type_ = find_call(self.type_name) if ":" in self.type_name else None
        if self.type_name:
            _check_type(session, service, type_.__qualname__ if type_ else self.type_name)
        return _payload(session, service, self.values, type_)


def typed_request(words: Sequence[str]) -> TypedRequest:
    """The type and the request of these words. Raises click.UsageError for others."""
    type_name, text = _split(words)
    return TypedRequest(type_name, checked_map(text, "REQUEST"))


def types_of(service: ServiceInfo) -> str:
    """The names of a service's types, for a sentence."""
    return ", ".join(service.types) or "unknown"


def _split(words: Sequence[str]) -> tuple[str, str]:
    """The name of a type, "" if it is omitted, and the request."""
    if len(words) > 2:
        raise click.UsageError(
            f"expected a type and a map of fields, got {len(words)} words: quote the map"
        )
    if len(words) == 2:
        return words[0], words[1]
    if words and bare(words[0]).isidentifier() and read_map(words[0]) is None:
        return words[0], "{}"
    return "", words[0] if words else "{}"


def _check_type(session: Session, service: str, type_name: str) -> None:
    info = look(session).services.get(service)
    if info and info.servers and not any(is_of_type(each, type_name) for each in info.types):
        raise click.UsageError(f"{service!r} is of type {types_of(info)}, not {type_name}")


def _payload(session: Session, service: str, values: dict[str, Any], type_: type | None) -> bytes:
    """The bytes of a request, complete if its type is known: given, or in `tfbus.messages`.

    Raises click.UsageError for values that are no request of that type.
    """
    if type_ is None:
        info = look(session, warns=False).services.get(service)
        names = {end.type for end in info.servers} if info else set()
        type_ = supplied_call(names.pop()) if len(names) == 1 else None
    request = request_of(type_)
    return encode_values(complete_values(values, request) if request else values, "REQUEST")


def follow(
    session: Session, service: str, payload: bytes, timeout_s: float
) -> Iterator[dict[str, Any]]:
    """The answers as they come; an early end cancels the accepted action.

    Raises ServiceError if the service refuses, does not exist, or sends nothing for `timeout_s`,
    RightsError if this identity may not call it on a closed bus.
    """
    session.settings.check_right("calls", service)
    accepted = []
    answered = False
    signals = StopSignals()  # which raise KeyboardInterrupt here
    try:
        for answer in _answers(session, service, payload, timeout_s):
            if answer.refusal is not None:
                raise ServiceError(answer.refusal or _silence(service, timeout_s))
            values = decode_map(answer.payload)
            answered = True
            if isinstance(values.get("accepted"), str):
                accepted.append(values["accepted"])
            yield values
    except BaseException:  # also Ctrl-C, and a caller that stops reading
        for goal in accepted:
            cancel = encode_map({"id": goal})
            list(session.ask(f"{service}/cancel", cancel, timeout_s=_CANCEL_TIMEOUT_S))
        raise
    finally:
        signals.uninstall()
    if not answered:
        raise ServiceError(_no_service(session, service))


def _answers(session: Session, service: str, payload: bytes, timeout_s: float) -> Iterator[Answer]:
    """The answers as they come. Raises ServiceError if none comes for `timeout_s`."""
    answers: queue.SimpleQueue[Answer | None] = queue.SimpleQueue()
    session.ask_later(
        service, payload, answers.put, lambda: answers.put(None), timeout_s=_LONGEST_ACTION_S
    )
    try:
        while (answer := answers.get(timeout=timeout_s)) is not None:
            yield answer
    except queue.Empty:
        raise ServiceError(_silence(service, timeout_s)) from None


def _silence(service: str, timeout_s: float) -> str:
    return f"{service!r} did not answer in {timeout_s:g} s"


def _no_service(session: Session, service: str) -> str:
    served = [name for name, info in look_once(session).services.items() if info.servers]
    return f"no service {service!r}{did_you_mean(service, served, none=', nor any other')}"
