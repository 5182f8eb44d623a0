"""`tfbus call`: call a service, or send a goal and follow it, from the command line."""

import json
import math
from typing import Any

import click

from tfbus.cli.bus import open_bus
from tfbus.codec import decode_map, encode_map
from tfbus.errors import ServiceError
from tfbus.keys import check_topic
from tfbus.options import bus_options
from tfbus.presence import describe_nodes, list_nodes
from tfbus.session import Session
from tfbus.settings import NodeSettings


@click.command(
    epilog="Example: tfbus call spawn '{x: 2, y: 3, theta: 0, name: turtle2}'",
)
@click.argument("service")
@click.argument("request", default="{}")
@click.option(
    "--timeout",
    "timeout_s",
    type=click.FloatRange(0, 1e6, min_open=True),
    default=5.0,
    metavar="S",
    help="Wait so long for an answer; 5 s.",
)
@bus_options("call")
def command(settings: NodeSettings, service: str, request: str, timeout_s: float) -> None:
    """Call a service, or send a goal and follow it.

    REQUEST is a YAML map of its fields. Each answer is printed as one line of JSON: a service
    has one, a goal tells its feedback and then its result.
    """
    if math.isnan(timeout_s):
        raise click.BadParameter("a number of seconds is wanted, not nan", param_hint="--timeout")
    payload = _read_request(request)
    with open_bus(settings) as session:
        answered = False
        for answer in session.ask(
            check_topic(service, kind="service"), payload, timeout_s=timeout_s
        ):
            if answer.refusal is not None:
                raise ServiceError(
                    answer.refusal or f"{service!r} did not answer in {timeout_s:g} s"
                )
            click.echo(json.dumps(decode_map(answer.payload), default=_as_json))
            answered = True
        if not answered:
            raise ServiceError(_nobody(session, service))


def _read_request(text: str) -> bytes:
    try:
        return encode_map(_as_map(text))
    except (OverflowError, TypeError, ValueError) as error:
        raise click.BadParameter(
            f"{text!r} has a value that no field can have: use texts, booleans, numbers of at "
            "most 64 bits, lists and maps",
            param_hint="REQUEST",
        ) from error


def _as_json(value: object) -> str:
    return value.hex() if isinstance(value, bytes) else str(value)


def _as_map(text: str) -> dict[str, Any]:
    import yaml

    try:
        value = yaml.safe_load(text)
    except (yaml.YAMLError, RecursionError) as error:
        raise click.BadParameter(f"{text!r} is not YAML", param_hint="REQUEST") from error
    if not isinstance(value, dict):
        raise click.BadParameter(
            f"a map of the request's fields is wanted, as in '{{x: 2, y: 3}}', not {text!r}",
            param_hint="REQUEST",
        )
    return value


def _nobody(session: Session, service: str) -> str:
    served = sorted(
        {
            name
            for node in list_nodes(session)
            for description in describe_nodes(session, node)
            for name in description["serves"]
        }
    )
    there = f"there are: {', '.join(served)}" if served else "no node serves anything"
    return f"nobody serves {service!r}; {there}"
