"""Reads and sets parameters of nodes.

If several nodes share a name the first that answers counts, and `warn(text)` is called.
"""

from collections.abc import Callable

from tfbus.base.errors import BusError, DecodeError, ParameterError
from tfbus.bus.presence import PATIENCE_S, describe_nodes, key_beside
from tfbus.bus.query import Answer
from tfbus.bus.session import Session
from tfbus.wire.codec import decode_message, encode_map
from tfbus.wire.descriptions import ParameterDescription
from tfbus.wire.keys import (
    escape,
    node_parameters_key,
    parameter_key,
    relative_name,
    setting_key,
)

Warn = Callable[[str], object]


def parameters_of(session: Session, node: str) -> list[ParameterDescription]:
    """All parameters of the node, by name. Raises BusError if there is no such node."""
    described = _ask(session, node, None)
    if not described:
        describe_nodes(session, node)  # raises if there is no such node
    return sorted(described, key=lambda parameter: parameter.name)


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


def full_name_of(session: Session, node: str) -> str:
    """The full name of a node, given a name relative to the session's namespace or a full one."""
    namespace = session.settings.namespace
    name = relative_name(node, namespace)
    return name if name.startswith("/") else "/" + "/".join(filter(None, (namespace, name)))


def _one(
    session: Session, node: str, described: list[ParameterDescription], warn: Warn
) -> ParameterDescription:
    if not described:
        describe_nodes(session, node)
        raise BusError(f"node {node!r} did not answer")
    if len(described) > 1:
        warn(f"{len(described)} nodes have the name {node}")
    return described[0]


def _ask(
    session: Session, node: str, parameter: str | None, payload: bytes | None = None
) -> list[ParameterDescription]:
    """The node's answers about its parameter, or all of its parameters if that is None."""

    is_setting = payload is not None and session.settings.closed is not None

    def key_of(name: str) -> str:
        if parameter is None:
            return node_parameters_key(name)
        return (setting_key if is_setting else parameter_key)(name, parameter)

    key = key_beside(node, key_of, session.settings.namespace)
    described = []
    for answer in session.ask(key, payload, timeout_s=PATIENCE_S):
        if answer.refusal is not None:
            raise ParameterError(answer.refusal or f"node {node!r} did not answer in time")
        described.append(_read(node, answer))
    return described


def _read(node: str, answer: Answer) -> ParameterDescription:
    try:
        return decode_message(ParameterDescription, answer.payload)
    except DecodeError as error:
        raise DecodeError(f"the parameters of node {node!r} are unreadable: {error}") from error
