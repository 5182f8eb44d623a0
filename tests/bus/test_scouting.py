"""Zenoh's scouting messages, in the form of eclipse-zenoh 1.10."""

import pytest

from tfbus.base.structs import replace
from tfbus.bus.scouting import Hello, decode_hello, encode_hello, encode_scout, is_scout_for

# A peer at two addresses, and a router without any.
PEER = Hello("4d3c2b1a", "peer", ("tcp/10.0.0.1:7447", "tls/[fe80::1]:7448"))
PEER_BYTES = bytes.fromhex("22 09 31 1a2b3c4d 02 11") + b"tcp/10.0.0.1:7447\x12tls/[fe80::1]:7448"
ROUTER = Hello("1", "router", ())
ROUTER_BYTES = bytes.fromhex("02 09 00 01")


@pytest.mark.parametrize(("hello", "message"), [(PEER, PEER_BYTES), (ROUTER, ROUTER_BYTES)])
def test_a_hello_has_zenohs_bytes(hello: Hello, message: bytes) -> None:
    """A Hello is written and read as Zenoh does."""
    assert (encode_hello(hello), decode_hello(message)) == (message, hello)


def test_a_locator_may_be_long() -> None:
    """Lengths beyond 127 take two bytes."""
    hello = replace(PEER, locators=("tcp/" + "h" * 200 + ":1",))
    assert decode_hello(encode_hello(hello)) == hello


def test_a_damaged_hello_is_none() -> None:
    """A Hello that is cut off anywhere is not taken."""
    assert {decode_hello(PEER_BYTES[:end]) for end in range(len(PEER_BYTES))} == {None}


@pytest.mark.parametrize("message", [b"", b"\x01\x09\x03", b"\x22\x08" + PEER_BYTES[2:]])
def test_other_messages_are_no_hello(message: bytes) -> None:
    """Scouts, messages of other versions and empty ones are no Hello."""
    assert decode_hello(message) is None


@pytest.mark.parametrize(
    ("role", "expected"), [("router", True), ("peer", True), ("client", False)]
)
def test_a_scout_looks_for_routers_and_peers(role: str, expected: bool) -> None:
    """A Scout is answered by routers and peers."""
    assert is_scout_for(encode_scout(), role) is expected
