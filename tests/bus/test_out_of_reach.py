"""The hints on a bus that scouting finds and that a session gets no link to."""

import socket
from dataclasses import dataclass, field, replace
from typing import Any, cast

import pytest

from tfbus import NodeSettings
from tfbus.base.errors import BusError
from tfbus.bus import presence
from tfbus.bus.presence import bus_out_of_reach
from tfbus.bus.session import Session

TLS = ("tls/[fe80::1]:4711", "tls/10.0.0.1:4711")
TCP = ("tcp/10.0.0.2:4712",)


@dataclass
class FakeSession:
    """A session with links to some of those that scouting finds."""

    settings: NodeSettings = field(default_factory=lambda: NodeSettings("tool"))
    links: frozenset[str] = frozenset()
    id: str = "own"

    def linked(self) -> set[str]:
        return set(self.links)


@pytest.fixture
def answering(monkeypatch: pytest.MonkeyPatch) -> dict[str, tuple[str, ...]]:
    """What answers scouting; the session itself does too."""
    hellos: dict[str, tuple[str, ...]] = {"own": TLS}
    monkeypatch.setattr(presence, "scout", lambda *_, **__: hellos)
    return hellos


def of_identity() -> NodeSettings:
    settings = NodeSettings("tool")
    object.__setattr__(settings, "closed", object())
    return settings


def said(session: FakeSession) -> str:
    return bus_out_of_reach(cast(Session, session))


def test_a_closed_bus_is_named_to_a_process_without_an_identity(answering: Any) -> None:
    """With an address of IPv4 where it has one; an open process is no reason."""
    answering["open"] = TCP
    assert said(FakeSession()) == ""
    answering["arm"] = TLS
    hint = said(FakeSession())
    assert "closed bus" in hint and "(tls/10.0.0.1:4711)" in hint
    assert hint.endswith("by --secure DIR")


def test_a_process_by_an_identity_hears_which_bus_it_is(answering: Any) -> None:
    """That of another authority, or an open one; with a link to it there is nothing to say."""
    session = FakeSession(of_identity())
    answering["arm"] = TLS
    assert "closed bus is here (tls/10.0.0.1:4711)" in said(session)
    assert "this identity gets no link" in said(session)
    assert said(replace(session, links=frozenset({"arm"}))) == ""
    answering["arm"] = TCP
    hint = said(session)
    assert "open bus" in hint and "(tcp/10.0.0.2:4712)" in hint
    assert hint.endswith("without --secure")


def test_a_client_with_a_router_is_not_kept_out(answering: Any) -> None:
    """It reaches the others by its router."""
    answering["arm"] = TLS
    settings = NodeSettings("tool", mode="client")
    assert said(FakeSession(settings, links=frozenset({"router"}))) == ""
    assert said(FakeSession(settings)) != ""


@pytest.mark.real
def test_an_endpoint_that_does_not_answer_is_named(answering: Any) -> None:
    """It is the first reason; one that answers is none."""
    with socket.socket() as silent:
        silent.bind(("127.0.0.1", 0))  # it does not listen, and no other can
        endpoint = f"tcp/127.0.0.1:{silent.getsockname()[1]}"
        reason = said(FakeSession(NodeSettings("tool", connect=(endpoint,))))
        assert f"answers at {endpoint} (Connection refused): " in reason
        assert reason.endswith("--connect")
    with socket.create_server(("127.0.0.1", 0)) as router:
        answers = NodeSettings("tool", connect=(f"tcp/127.0.0.1:{router.getsockname()[1]}",))
        assert said(FakeSession(answers)) == ""


def test_without_scouting_nothing_is_said(answering: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither where it is off, nor where this host cannot ask."""
    answering["arm"] = TLS
    with monkeypatch.context() as without:
        without.setattr(presence, "has_scouting", lambda _: False)
        assert said(FakeSession()) == ""

    def fail(*_: object, **__: object) -> dict[str, tuple[str, ...]]:
        raise BusError("could not look for others by scouting")

    monkeypatch.setattr(presence, "scout", fail)
    assert said(FakeSession()) == ""
