"""A session of the bus that follows a scenario, and notes its observations.

As a program it reads commands, a line of JSON each, and answers each with a line.
"""

import json
import logging
import sys
from collections.abc import Callable
from typing import Any

from tfbus.base.errors import BusError
from tfbus.bus.query import Query
from tfbus.bus.retained import ask_retained, declare_retained_publisher, declare_retained_subscriber
from tfbus.bus.session import Session
from tfbus.bus.settings import NodeSettings


class Actor:
    """A session and what it has declared, by names; `events` has what came, by the same names."""

    def __init__(self, name: str, options: dict[str, Any]) -> None:
        log = logging.getLogger(f"actor {name}")
        settings = NodeSettings(name, **options)
        # The router of a site, which is a client, listens for its own clients.
        is_site = settings.mode == "client" and bool(settings.listen)
        self.session = Session(settings, log, patience_s=10.0, opens_alone=is_site)
        self.events: dict[str, list[str]] = {}
        self._declared: dict[str, Any] = {}
        self._held: list[Query] = []

    def do(self, verb: str, *args: Any) -> Any:
        """Do one thing; its result, or the error as a text."""
        try:
            return getattr(self, f"_{verb}")(*args)
        except BusError as error:
            return f"BusError: {error}"

    def _note(self, name: str) -> Callable[[str], None]:
        events = self.events.setdefault(name, [])
        return events.append

    def _id(self) -> str:
        return self.session.id

    def _links(self) -> list[str]:
        return sorted(self.session.linked())

    def _publisher(self, key: str) -> None:
        self._declared[f"publisher {key}"] = self.session.publisher(key)

    def _retained_publisher(self, key: str) -> None:
        self._declared[f"publisher {key}"] = declare_retained_publisher(self.session, key)

    def _put(self, key: str, text: str) -> None:
        self._declared[f"publisher {key}"].put(text.encode())

    def _flood(self, key: str, messages: int, size: int) -> None:
        for number in range(messages):
            self._declared[f"publisher {key}"].put(f"{number} ".ljust(size).encode())

    def _heard(self, key: str) -> bool:
        name = f"heard {key}"
        if name not in self._declared:
            self._declared[name] = self.session.watch_heard(key)
        return bool(self._declared[name].heard)

    def _subscriber(self, name: str, key: str, others: bool = False) -> None:
        note = self._note(name)
        self._declared[name] = self.session.subscriber(
            key, lambda at, payload: note(f"{at}={payload.decode()}"), others=others
        )

    def _flooded(self, name: str, key: str) -> None:
        note = self._note(name)
        self._declared[name] = self.session.subscriber(
            key, lambda at, payload: note(payload.split()[0].decode())
        )

    def _retained_subscriber(self, name: str, key: str) -> None:
        note = self._note(name)
        self._declared[name] = declare_retained_subscriber(
            self.session, key, lambda at, payload: note(f"{at}={payload.decode()}")
        )

    def _queryable(self, name: str, key: str, *texts: str) -> None:
        def answer(query: Query) -> None:
            payload = query.payload.decode()
            for text in texts:
                query.answer(key, f"{text}{payload}".encode())
            query.close()

        self._declared[name] = self.session.queryable(key, answer)

    def _refusing_queryable(self, name: str, key: str, text: str) -> None:
        def refuse(query: Query) -> None:
            query.refuse(text)
            query.close()

        self._declared[name] = self.session.queryable(key, refuse)

    def _silent_queryable(self, name: str, key: str) -> None:
        self._declared[name] = self.session.queryable(key, self._held.append)

    def _release(self) -> None:
        while self._held:
            self._held.pop().close()

    def _ask(self, key: str, timeout_s: float = 5.0, payload: str | None = None) -> list[str]:
        data = None if payload is None else payload.encode()
        answers = self.session.ask(key, data, timeout_s=timeout_s)
        return sorted(
            f"{each.key}={each.payload.decode()}"
            if each.refusal is None
            else f"refused: {each.refusal}"
            for each in answers
        )

    def _ask_later(self, name: str, key: str, timeout_s: float) -> None:
        note = self._note(name)
        self.session.ask_later(
            key,
            None,
            lambda answer: note(f"answer {answer.payload.decode()}"),
            lambda: note("end"),
            timeout_s=timeout_s,
        )

    def _ask_retained(self, key: str) -> list[str]:
        return sorted(
            f"{each.key}={each.payload.decode()}"
            for each in ask_retained(self.session, key)
            if each.refusal is None
        )

    def _served(self, key: str) -> bool:
        name = f"served {key}"
        if name not in self._declared:
            self._declared[name] = self.session.watch_served(key)
        return bool(self._declared[name].served)

    def _token(self, key: str) -> None:
        self._declared[f"token {key}"] = self.session.token(key)

    def _watch(self, name: str, key: str) -> None:
        note = self._note(name)
        self._declared[name] = self.session.watch_living(
            key, lambda at, alive: note(f"{'+' if alive else '-'}{at}")
        )

    def _living(self, key: str) -> list[str]:
        return self.session.living(key)

    def _end(self, name: str) -> None:
        self._declared.pop(name).close()

    def _events(self, name: str) -> list[str]:
        return list(self.events.get(name, ()))

    def _close(self) -> None:
        self.session.close()


def main() -> None:
    """Serve one actor over standard input and output."""
    name, options = json.loads(sys.argv[1])
    actor = Actor(name, options)
    print(json.dumps("open"), flush=True)
    for line in sys.stdin:
        verb, *args = json.loads(line)
        print(json.dumps(actor.do(verb, *args)), flush=True)
    actor.session.close()


if __name__ == "__main__":
    main()
