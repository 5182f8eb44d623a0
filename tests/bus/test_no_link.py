"""A client that gets no link to a router hears why: one of the two is on a closed bus."""

import logging
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.buses import DEADLINE_S
from tests.live_bus import free_port
from tfbus import BusError, NodeSettings
from tfbus.bus import links
from tfbus.bus.links import speaks_tls, why_unreachable
from tfbus.bus.session import Session

pytest.importorskip("cryptography", reason="needs cryptography: pip install cryptography")

from tfbus.bus.keystore import Keystore
from tfbus.bus.rights import Identity

pytestmark = pytest.mark.real

LOG = logging.getLogger("test")


def identity(folder: Path, name: str) -> str:
    """The folder of an identity of an authority of its own."""
    keystore = Keystore.init(folder, days=10)
    keystore.add(Identity(name, "router"), days=5)
    return str(keystore.path / name)


Router = Callable[[str, str], str]


@pytest.fixture
def router(tmp_path: Path) -> Iterator[Router]:
    sessions: list[Session] = []

    def started(protocol: str, secure: str) -> str:
        endpoint = f"{protocol}/127.0.0.1:{free_port()}"
        settings = NodeSettings("hub", mode="router", listen=(endpoint,), secure=secure)
        sessions.append(Session(settings, LOG))
        return endpoint

    yield started
    for session in sessions:
        session.close()


def refusal(endpoint: str, secure: str = "") -> str:
    """Why a client of this identity cannot join by the endpoint."""
    settings = NodeSettings("eye", mode="client", connect=(endpoint,), secure=secure)
    with pytest.raises(BusError) as caught:
        Session(settings, LOG).close()
    return str(caught.value)


@pytest.fixture
def slow_router(router: Router, monkeypatch: pytest.MonkeyPatch) -> Router:
    """As `router`; on a busy machine it may greet a client after the usual two seconds."""
    monkeypatch.setattr(links, "_CONNECT_WITHIN_S", DEADLINE_S)
    return router


def test_an_open_client_learns_that_the_bus_is_closed(slow_router: Router, tmp_path: Path) -> None:
    """And how to join it."""
    closed = slow_router("tls", identity(tmp_path / "keys", "hub"))
    address = closed.removeprefix("tls/")
    said = refusal(f"tcp/{address}")
    assert f"closed bus is at tcp/{address}" in said
    assert "--secure DIR" in said and f"--connect tls/{address}" in said


def test_a_closed_client_learns_that_the_bus_is_open(router: Router, tmp_path: Path) -> None:
    """And how to join it."""
    opened = router("tcp", "")
    address = opened.removeprefix("tcp/")
    said = refusal(f"tls/{address}", identity(tmp_path / "keys", "eye"))
    assert "an open bus" in said and f"--connect tcp/{address}" in said


def test_an_identity_of_another_authority_learns_that(slow_router: Router, tmp_path: Path) -> None:
    """The router is there, and takes no link from it."""
    closed = slow_router("tls", identity(tmp_path / "keys", "hub"))
    said = refusal(closed, identity(tmp_path / "others", "eye"))
    assert f"closed bus at {closed}" in said and "this identity no link" in said


def test_where_nothing_answers_it_says_so() -> None:
    """As ever."""
    nowhere = f"tcp/127.0.0.1:{free_port()}"
    assert speaks_tls(nowhere) is None
    assert f"no router answers at {nowhere}" in refusal(nowhere)


@pytest.mark.parametrize("host", ["10.0..7", "a" * 64])
def test_a_name_that_no_host_has_is_said(host: str) -> None:
    """As after a slip on the keyboard: Python looks such a name up nowhere."""
    assert "no host has such a name" in why_unreachable(f"tcp/{host}:7447")
    assert speaks_tls(f"tcp/{host}:7447") is None
