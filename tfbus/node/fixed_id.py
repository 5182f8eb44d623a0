"""Zenoh's id if a configuration file sets it: of two processes that share it, one is lost."""

import logging
from contextlib import suppress

from tfbus.bus.query import Answer
from tfbus.bus.session import Session
from tfbus.bus.settings import NodeSettings
from tfbus.bus.zenoh_config import id_in_file
from tfbus.errors import BusError, DecodeError
from tfbus.runtime import scheduler
from tfbus.wire.codec import decode_message
from tfbus.wire.descriptions import NodeDescription
from tfbus.wire.keys import ALL_NODES_EVERYWHERE
from tfbus.wording import printable

_ANSWER_WITHIN_S = 1.0

# A busy machine finds the others late: while no node answers, the question is repeated.
_FOUND_WITHIN_S = 2.0
_AGAIN_AFTER_S = 0.1


def check_id_is_free(settings: NodeSettings, log: logging.Logger, patience_s: float) -> None:
    """Raise BusError if a node on the bus has the id that the configuration file sets.

    A session with an id of its own looks first: one with the same id would take the place of the
    other, without a word. If no node answers it looks for 2 s, at most `patience_s`. If the
    file sets no id, there is nothing to do.
    """
    taken = id_in_file(settings.config)
    if taken is None:
        return
    with Session(settings, log, patience_s=patience_s, is_second=True) as session:
        session.settle()
        for other in _others(session, min(patience_s, _FOUND_WITHIN_S)):
            if other.session == taken:
                raise BusError(
                    f"{settings.config} sets Zenoh's id {taken}, which node "
                    f"'{printable(other.name)}' on {printable(other.host)} with pid {other.pid} "
                    "has: remove 'id' from the file, or give each process its own"
                )


def _others(session: Session, within_s: float) -> list[NodeDescription]:
    """The nodes on the bus, once one of them has answered; empty if none does in time."""
    deadline = scheduler.monotonic() + within_s
    while True:
        answers = session.ask(ALL_NODES_EVERYWHERE, timeout_s=_ANSWER_WITHIN_S)
        found = [other for other in map(_described, answers) if other is not None]
        if found or scheduler.monotonic() >= deadline:
            return found
        scheduler.sleep(_AGAIN_AFTER_S)


def _described(answer: Answer) -> NodeDescription | None:
    if answer.refusal is None:
        with suppress(DecodeError):
            return decode_message(NodeDescription, answer.payload)
    return None
