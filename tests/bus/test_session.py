"""Sessions: Zenoh's configuration, links, the end, and long answers."""

import json
import logging
import threading
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import zenoh

from tests.builders import examples
from tests.buses import DEADLINE_S, eventually, send_until
from tests.simulated_bus import Bus
from tfbus import BusError, Node, NodeSettings
from tfbus.bus.query import Answer, Query
from tfbus.bus.session import Session
from tfbus.bus.zenoh_config import end_shared_memory, zenoh_config


def setting(key: str, config: str, folder: Path, suffix: str = "json5") -> str:
    """Zenoh's setting of a key with this configuration file ("" for none)."""
    path = folder / f"zenoh.{suffix}"
    path.write_text(config)
    settings = NodeSettings("sim", config=str(path) if config else "")
    return str(zenoh_config(settings).get_json(key))


def lease_ms(config: str, folder: Path) -> str:
    """The lease of a session with this configuration file ("" for none)."""
    return setting("transport/link/tx/lease", config, folder)


@pytest.mark.parametrize("config", ["", "{}", "{mode: 'client'}"])
def test_a_silent_link_is_lost_within_two_seconds(config: str, tmp_path: Path) -> None:
    """An unplugged host is noticed after a lease of 1.5 s, without a configuration and with one."""
    assert lease_ms(config, tmp_path) == "1500"


@pytest.mark.parametrize("lease", ["4000", "10000"])
def test_a_configuration_file_may_set_another_lease(lease: str, tmp_path: Path) -> None:
    """The lease in the configuration file counts, even where it is Zenoh's default of 10 s."""
    config = f"{{transport: {{link: {{tx: {{lease: {lease}}}}}}}}} // a slow network"
    assert lease_ms(config, tmp_path) == lease


def test_a_configuration_file_may_be_yaml(tmp_path: Path) -> None:
    """A file in YAML counts as one in JSON5 does."""
    config = "transport:\n  link:\n    tx:\n      lease: 10000\n"
    assert setting("transport/link/tx/lease", config, tmp_path, "yaml") == "10000"


@pytest.mark.parametrize(
    ("config", "enabled"),
    [
        ("", "false"),
        ("{mode: 'client'}", "false"),
        ("{transport: {shared_memory: {enabled: true}}}", "true"),
        ("{transport: {shared_memory: {mode: 'init'}}}", "true"),
    ],
)
def test_memory_is_shared_between_processes_where_a_configuration_file_asks_for_it(
    config: str, enabled: str, tmp_path: Path
) -> None:
    """Zenoh's shared memory costs an idle process CPU: it is off unless a file enables it."""
    assert setting("transport/shared_memory/enabled", config, tmp_path) == enabled


@pytest.mark.parametrize(
    ("may_lock", "enabled", "why"),
    [(8_000_000, "false", "may lock 8 MB of memory"), (256_000_000, "true", "")],
)
def test_memory_is_not_shared_by_a_process_that_could_not_read_it(
    may_lock: int, enabled: str, why: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A process that may lock little memory takes large messages by TCP, and the log says why."""
    monkeypatch.setattr("tfbus.bus.zenoh_config.lockable_bytes", lambda: may_lock)
    config = zenoh.Config.from_json5("{transport: {shared_memory: {enabled: true}}}")
    assert why in end_shared_memory(config)
    assert config.get_json("transport/shared_memory/enabled") == enabled


@pytest.mark.real
def test_two_introduced_peers_have_one_link(bus: Bus) -> None:
    """Of two peers that learn of each other from a third, only one connects."""
    peers = [bus.node(f"peer{number}").session.zenoh for number in range(4)]
    for peer in peers:
        eventually(lambda peer=peer: len(list(peer.info.peers_zid())) == 4)
    assert [len(peer.info.links()) for peer in peers] == [4, 4, 4, 4]


@pytest.mark.real
def test_a_session_that_does_not_close_in_time_is_logged(
    bus: Bus, caplog: pytest.LogCaptureFixture
) -> None:
    """Where Zenoh cannot close in time, as a peer has stopped, the node still ends."""

    def close() -> None:
        raise zenoh.ZError("close operation timed out! at /root/zenoh/close.rs:135.")

    settings = NodeSettings("sim", config=str(bus.config), connect=(bus.endpoint,))
    session: Any = Session(settings, logging.getLogger("sim"))
    real, session.zenoh = session.zenoh, SimpleNamespace(close=close)
    session.close()
    real.close()
    [line] = caplog.messages
    assert "did not close" in line and line.endswith(": close operation timed out!")


@pytest.mark.real
def test_tokens_end_even_where_a_link_stays(bus: Bus, receiver: Node) -> None:
    """Where Zenoh leaves a link open that began while it closed, no token is alive on it."""
    settings = NodeSettings("sim", config=str(bus.quick_config), connect=(bus.endpoint,))
    session: Any = Session(settings, logging.getLogger("sim"))
    session.token("there")
    eventually(lambda: receiver.session.living("there"))
    real, session.zenoh = session.zenoh, SimpleNamespace(close=lambda: None)
    session.close()
    eventually(lambda: not receiver.session.living("there"))
    real.close()


def test_queries_beyond_the_limit_of_long_answers_are_refused(bus: Bus) -> None:
    """Four long answers are sent at a time, 64 queries wait, and further ones are refused."""
    session = bus.node("asked").session
    go_on = threading.Event()

    def answer(query: Query) -> None:
        go_on.wait()
        query.answer("long", b"answer")
        query.close()

    answers: list[Answer] = []
    ended: list[int] = []
    session.queryable("long", answer, long=True)
    for number in range(70):
        session.ask_later(
            "long", None, answers.append, lambda at=number: ended.append(at), timeout_s=60.0
        )
    eventually(lambda: len(ended) == 2)
    refusal = "too many queries at once; retry later"
    assert [answer.refusal for answer in answers] == [refusal, refusal]
    go_on.set()
    eventually(lambda: len(ended) == 70)
    assert [answer.payload for answer in answers[2:]] == [b"answer"] * 68


def test_a_second_session_is_another_on_free_ports(tmp_path: Path) -> None:
    """What a file fixes for one session of a process, its id and ports, another cannot have."""
    path = tmp_path / "zenoh.json5"
    path.write_text(
        "{id: 'a1', listen: {endpoints: {peer: ['tls/[::]:7447#iface=eth0', 'tcp/0.0.0.0:0'], "
        "router: ['tcp/h:7447']}}}"
    )
    config = zenoh_config(NodeSettings("sim", config=str(path)), is_second=True)
    assert json.loads(config.get_json("listen/endpoints")) == {
        "peer": ["tls/[::]:0#iface=eth0", "tcp/0.0.0.0:0"],
        "router": ["tcp/h:0"],
    }
    assert json.loads(config.get_json("id")) != "a1"


def test_a_second_session_that_opens_while_the_first_closes_is_closed(
    bus: Bus, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first ends its own before it knows of the second, which must not live on."""
    session = bus.node("sim", namespace="robot7").session
    opened: list[Session] = []

    def open_late(*args: Any, **kwargs: Any) -> Session:
        opened.append(Session(*args, **kwargs))
        session.close()
        return opened[-1]

    monkeypatch.setattr("tfbus.bus.session.Session", open_late)
    with pytest.raises(BusError, match="the session is closed"):
        session.placed("/elsewhere/tf/sim")
    assert opened[0].zenoh.is_closed()


def test_a_publisher_may_end_while_another_thread_sends_by_it(bus: Bus) -> None:
    """The thread that ends it sees no error; the one that sends is told that it is closed."""
    node = bus.node("sender")
    node.session.subscriber("a", lambda key, payload: None)
    payload = b"x" * 10_000
    for _ in range(examples(20)):
        publisher = node.session.publisher("a")
        sent: list[bytes] = []
        errors: list[BusError] = []

        def send(
            put: Callable[[bytes], object] = publisher.put,
            sent: list[bytes] = sent,
            errors: list[BusError] = errors,
        ) -> None:
            while not errors:
                try:
                    put(payload)
                    sent.append(payload)
                except BusError as error:
                    errors.append(error)

        thread = threading.Thread(target=send, daemon=True)
        thread.start()
        eventually(lambda sent=sent: sent)
        publisher.close()
        publisher.close()
        thread.join(DEADLINE_S)
        assert "could not publish a" in str(errors[0])


def test_a_callback_may_close_its_own_session(bus: Bus, caplog: pytest.LogCaptureFixture) -> None:
    """Zenoh's end waits for the callback, so `close` does not wait for Zenoh's end."""
    receiver, sender = bus.node("receiver"), bus.node("sender")
    is_closed = threading.Event()

    def close(payload: bytes) -> None:
        receiver.close()
        is_closed.set()

    receiver.create_raw_subscription("topic", close)
    publisher = sender.create_raw_publisher("topic")
    send_until(lambda: publisher.publish(b"x"), is_closed.is_set)
    eventually(receiver.session.zenoh.is_closed)
    assert not [text for text in caplog.messages if "close cleanly" in text]
