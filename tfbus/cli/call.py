"""`tfbus call`: call a service or an action from the command line."""

import queue
from collections.abc import Iterator
from typing import Any

import click

from tfbus.bus.query import Answer
from tfbus.bus.session import Session
from tfbus.bus.settings import NodeSettings
from tfbus.cli.bus import look, open_bus
from tfbus.cli.messages.fields import request_of
from tfbus.cli.messages.message import (
    checked_map,
    complete_values,
    encode_values,
    supplied_call,
)
from tfbus.cli.messages.prototype import complete_request
from tfbus.cli.output import print_json
from tfbus.command.options import bus_options
from tfbus.command.types import POSITIVE, ServiceName
from tfbus.errors import ServiceError
from tfbus.runtime.signals import StopSignals
from tfbus.wire.codec import decode_map, encode_map
from tfbus.wire.keys import relative
from tfbus.wording import did_you_mean

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


@click.command(
    epilog="Example: tfbus call spawn '{x: 2, y: 3, theta: 0, name: turtle2}'",
)
@click.argument("service", type=ServiceName())
@click.argument("request", default="{}", shell_complete=complete_request)
@TIMEOUT
@bus_options("call")
def command(settings: NodeSettings, service: str, request: str, timeout_s: float) -> None:
    """Call a service or an action, and print its answers.

    REQUEST is a YAML map of fields; missing ones get their defaults, or zeros. Each answer is one
    line of JSON: the response of a service, or the feedback and then the result of an action.
    Ctrl-C cancels an action.
    """
    values = checked_map(request, "REQUEST")
    service = relative(service, settings.namespace)
    with open_bus(settings) as session:
        payload = request_payload(session, service, values)
        for answer in follow(session, service, payload, timeout_s):
            print_json(answer)


def request_payload(
    session: Session, service: str, values: dict[str, Any], type_: type | None = None
) -> bytes:
    """The bytes of a request, complete where its type is known: given, or in `tfbus.messages`.

    Raises click.UsageError for values that are no request of that type.
    """
    if type_ is None:
        info = look(session, lambda error: None).services.get(service)
        names = {end.type for end in info.servers} if info else set()
        type_ = supplied_call(names.pop()) if len(names) == 1 else None
    request = request_of(type_)
    return encode_values(complete_values(values, request) if request else values, "REQUEST")


def follow(
    session: Session, service: str, payload: bytes, timeout_s: float
) -> Iterator[dict[str, Any]]:
    """The answers as they come; an early end cancels the accepted action.

    Raises ServiceError if the service refuses, does not exist, or sends nothing for `timeout_s`.
    """
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
    served = [name for name, info in look(session).services.items() if info.servers]
    return f"no service {service!r}{did_you_mean(service, served, none=', nor any other')}"
