"""Reads and sets parameters of nodes.

If several nodes share a name the first that answers counts, and `warn(text)` is called.
"""

from collections.abc import Callable, Iterable
from operator import attrgetter

from tfbus.base.errors import BusError, DecodeError, ParameterError
from tfbus.bus.presence import (
    PATIENCE_S,
    ask_node,
    describe_nodes,
    full_name_of,
    key_beside,
)
from tfbus.bus.query import Answer
from tfbus.bus.session import Session
from tfbus.wire.codec import decode_message, encode_map
from tfbus.wire.descriptions import ParameterDescription
from tfbus.wire.keys import (
    escape,
    node_parameters_key,
    parameter_key,
    setting_key,
)

Warn = Callable[[str], object]


def parameters_of(session: Session, node: str) -> list[ParameterDescription]:
    """All parameters of the node, by name. Raises BusError if there is no such node."""
    key = key_beside(node, node_parameters_key, session.settings.namespace)
    described = _read(node, session.ask(key, timeout_s=PATIENCE_S))
    if not described:  # it has none, or has not said yet what it serves
        described = [each for known in describe_nodes(session, node) for each in known.parameters]
    return sorted(described, key=attrgetter("name"))


def parameter_of(session: Session, node: str, name: str, warn: Warn) -> ParameterDescription:
    """A parameter of the node. Raises an error if there is no such parameter or node."""
    return _one(session, node, _ask(session, node, name), warn)


def set_parameter(
    session: Session, node: str, name: str, value: object, warn: Warn
) -> ParameterDescription:
    """Set a parameter and return it. Raises ParameterError if the node refuses, RightsError if
    this identity may not set it on a closed bus.
    """
    full_name = full_name_of(session, node)
    session.settings.check_right("sets", f"{full_name}/{escape(name)}")
    answers = _ask(session, node, name, encode_map({"value": value}))
    return _one(session, node, answers, warn)


def _one(
    session: Session, node: str, described: list[ParameterDescription], warn: Warn
) -> ParameterDescription:
    if not described:
        raise BusError(f"node {node!r} did not answer")
    if len(described) > 1:
        warn(f"{len(described)} nodes have the name {node}")
    return described[0]


def _ask(
    session: Session, node: str, parameter: str, payload: bytes | None = None
) -> list[ParameterDescription]:
    """The node's answers about its parameter. Raises BusError if there is no such node."""
    is_setting = payload is not None and session.settings.closed is not None
    key_of = setting_key if is_setting else parameter_key
    return _read(node, ask_node(session, node, lambda name: key_of(name, parameter), payload))


def _read(node: str, answers: Iterable[Answer]) -> list[ParameterDescription]:
    described = []
    for answer in answers:
        if answer.refusal is not None:
            raise ParameterError(answer.refusal or f"node {node!r} did not answer in time")
        try:
            described.append(decode_message(ParameterDescription, answer.payload))
        except DecodeError as error:
            raise DecodeError(f"the parameters of node {node!r} are unreadable: {error}") from error
    return described
