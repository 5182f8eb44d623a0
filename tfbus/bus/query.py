"""Queries: what other processes ask, and what they answer."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import zenoh

from tfbus.bus.zenoh_errors import bus_errors
from tfbus.errors import TfbusError

# What Zenoh puts in the place of an answer that has not come in time.
_NO_ANSWER_IN_TIME = b"Timeout"


@dataclass(frozen=True)
class Answer:
    """One answer to a query: its key and payload, or a refusal with its text.

    `refusal` is "" where the answer has not come in time, None where it is no refusal. `sender` is
    the id of the session that answered, as Zenoh names it; "" where it does not.
    """

    key: str
    payload: bytes
    refusal: str | None = None
    sender: str = ""


def answer_of(reply: zenoh.Reply) -> Answer:
    """The answer in a reply of Zenoh's."""
    if reply.ok is not None:
        sender = "" if reply.replier_id is None else str(reply.replier_id.zid)
        return Answer(str(reply.ok.key_expr), reply.ok.payload.to_bytes(), sender=sender)
    payload = reply.err.payload.to_bytes() if reply.err is not None else b""
    if payload == _NO_ANSWER_IN_TIME:
        payload = b""
    return Answer("", b"", refusal=payload.decode(errors="replace"))


class Query:
    """A query of another process: give it any number of answers, then close it."""

    def __init__(self, query: zenoh.Query):
        self._query = query
        self.key = str(query.key_expr)
        self.payload = query.payload.to_bytes() if query.payload is not None else b""

    def parameter(self, name: str) -> str | None:
        """The value of this name in the selector `key?name=value`; None where it has none."""
        return self._query.parameters.get(name)

    def answer(self, key: str, payload: bytes) -> None:
        """Send one answer; `key` lies within the key expression of the query."""
        with bus_errors(f"answer the query for {self.key}"):
            self._query.reply(key, payload)

    def refuse(self, reason: str) -> None:
        """Answer that this cannot be done, and why; the asker gets the reason."""
        with bus_errors(f"refuse the query for {self.key}"):
            self._query.reply_err(reason.encode())

    @contextmanager
    def answering(self, what: str) -> Iterator[None]:
        """Close the query at the end; an exception becomes a refusal, `what` failed and how."""
        try:
            yield
        except TfbusError as error:
            self.refuse(str(error))
        except Exception as error:
            self.refuse(f"{what} failed ({type(error).__name__}: {error})")
            raise
        finally:
            self.close()

    def close(self) -> None:
        """End the answers: the asker waits for no further ones."""
        self._query.drop()


def within(key: str, expression: str) -> bool:
    """Whether the key lies within the key expression."""
    return zenoh.KeyExpr(expression).includes(zenoh.KeyExpr(key))
