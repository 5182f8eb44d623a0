"""Every key that tfbus uses has a rule: the messages that each role may send on it."""

import inspect
import json
from pathlib import Path
from typing import Any

import pytest
import zenoh

from tfbus.bus.rights import ROLES, Identity, Rights, access_control
from tfbus.bus.settings import NodeSettings
from tfbus.bus.zenoh_config import zenoh_config
from tfbus.wire import keys

ALL = frozenset(ROLES)
PUBLISHERS = frozenset({"publisher", "admin", "router"})
SETTERS = frozenset({"operator", "admin", "router"})

READ = ("declare_subscriber",)
WATCH = ("liveliness_query", "declare_liveliness_subscriber")

# For each function or constant of tfbus.wire.keys: what is done at its key, and by which roles. The
# node and the stream have the name of the identity.
USES: dict[str, list[tuple[tuple[str, ...], frozenset[str]]]] = {
    "transforms_key": [(("put", "declare_queryable", "reply"), PUBLISHERS), (READ, ALL)],
    "transforms_key_beside": [(("put",), PUBLISHERS), (("query",), ALL)],
    "static_transforms_key": [
        (("put", "declare_queryable", "reply", "liveliness_token"), PUBLISHERS),
        (("query", *READ), ALL),
    ],
    "static_transforms_key_beside": [(("put",), PUBLISHERS), (("query",), ALL)],
    "stream_key": [
        (("put", "liveliness_token", "declare_queryable", "reply"), PUBLISHERS),
        ((*READ, *WATCH), ALL),
    ],
    "node_key": [(("liveliness_token", "declare_queryable", "reply"), ALL), (("query",), ALL)],
    "clock_key": [(("declare_queryable", "reply", "query"), ALL)],
    "kept_key": [(("liveliness_token", "declare_queryable", "reply", "query"), ALL)],
    "parameter_key": [(("reply", "query"), ALL)],
    "node_parameters_key": [(("declare_queryable", "query"), ALL)],
    "setting_key": [(("reply",), ALL), (("query",), SETTERS)],
    "node_settings_key": [(("declare_queryable",), ALL)],
    "ALL_TRANSFORMS": [(READ, ALL)],
    "ALL_STATIC_TRANSFORMS": [(READ, ALL)],
    "ALL_STREAMS": [((*READ, *WATCH, "query"), ALL)],
    "ALL_STREAMS_EVERYWHERE": [((*READ, *WATCH, "query"), ALL)],
    "ALL_TRANSFORMS_EVERYWHERE": [(READ, ALL)],
    "ALL_STATIC_TRANSFORMS_EVERYWHERE": [(READ, ALL)],
    "ALL_NODES": [((*WATCH, "query"), ALL)],
    "ALL_NODES_EVERYWHERE": [((*WATCH, "query"), ALL)],
    "ALL_KEEPERS": [(WATCH, ALL)],
    "ALL_KEEPERS_EVERYWHERE": [(WATCH, ALL)],
    "CLOCK_TOPIC": [(("put",), frozenset({"admin", "router"})), (READ, ALL)],
}
# What retained publishers and their subscribers have below a key.
RETAINED = {"static_transforms_key", "stream_key"}

# Functions that take keys apart, or patterns of another kind.
NO_KEYS = {
    "changed_selector",
    "definitions_selector",
    "description_selector",
    "kept_selector",
    "kept_transforms_selector",
    "page_selector",
    "TRANSFORMS",
    "STATIC_TRANSFORMS",
}


def key_of(name: str, node: str) -> str:
    """The key by a function or constant of tfbus.wire.keys, of a node and its stream."""
    found = getattr(keys, name)
    if isinstance(found, str):
        return found
    given = {"stream": node, "node": node, "parameter": "speed", "child": None}
    given["stream_key"] = keys.stream_key(node)
    return str(found(*(given[each] for each in inspect.signature(found).parameters)))


def is_allowed(control: dict[str, Any], name: str, message: str, key: str) -> bool:
    """Zenoh's decision on a message that comes from an identity."""
    by_id = {rule["id"]: rule for rule in control["rules"]}

    def fits(rule: dict[str, Any]) -> bool:
        return (
            "ingress" in rule["flows"]
            and message in rule["messages"]
            and any(
                zenoh.KeyExpr.autocanonize(each).includes(zenoh.KeyExpr(key))
                for each in rule["key_exprs"]
            )
        )

    names = {each["id"]: each["cert_common_names"] for each in control["subjects"]}
    for policy in control["policies"]:
        if any(name in names[subject] for subject in policy["subjects"]):
            rules = [by_id[rule] for rule in policy["rules"] if fits(by_id[rule])]
            if rules and all(rule["permission"] == "allow" for rule in rules):
                return True
    return False


def test_every_key_is_in_the_table() -> None:
    """A new key of the wire format needs a rule, and a line in the table above."""
    made = {
        name
        for name, value in vars(keys).items()
        if not name.startswith("_")
        and (
            (isinstance(value, str) and name.isupper())
            or name.endswith(("_key", "_key_beside", "_selector"))
        )
    }
    assert made == USES.keys() | NO_KEYS


@pytest.mark.parametrize("namespace", ["", "robot7"])
@pytest.mark.parametrize("role", ROLES)
def test_a_role_may_do_what_the_table_says(role: str, namespace: str) -> None:
    """Each message on each key is allowed for just the roles that need it."""
    control = access_control(Rights({"it": Identity("it", role, namespace)}))
    for name, uses in USES.items():
        key = "/".join(filter(None, (namespace, key_of(name, "it"))))
        for messages, roles in uses:
            for message in messages:
                allowed = is_allowed(control, "it", message, key)
                assert allowed is (role in roles), (name, message)
        if name in RETAINED:
            sends = role in PUBLISHERS
            assert is_allowed(control, "it", "put", f"{key}/@adv/pub/1/2/_") is sends
            assert is_allowed(control, "it", "liveliness_token", f"{key}/@adv/pub/1/2/_") is sends
            assert is_allowed(control, "it", "liveliness_token", f"{key}/@adv/sub/1/2/_")
            assert is_allowed(control, "it", "query", f"{key}/@adv/pub/**")


@pytest.mark.parametrize("role", ["reader", "publisher", "operator"])
@pytest.mark.parametrize("namespace", ["", "robot7"])
def test_none_but_an_admin_sends_what_is_another_s(role: str, namespace: str) -> None:
    """No role but admin and router has a rule for what another identity sends on its own keys."""
    control = access_control(Rights({"it": Identity("it", role, namespace)}))
    own = {
        message
        for uses in USES.values()
        for messages, _ in uses
        for message in messages
        if message not in (*READ, *WATCH, "query")
    }
    for name in USES:
        if callable(getattr(keys, name)):
            key = "/".join(filter(None, (namespace, key_of(name, "other"))))
            sent = [message for message in own if is_allowed(control, "it", message, key)]
            assert sent == [], name


def test_the_router_of_the_same_identity_carries_what_others_send() -> None:
    """A client takes from it what others may send; from other identities only what is theirs."""
    rights = Rights({name: Identity(name, "publisher", "robot7") for name in ("it", "leg")})
    control = access_control(rights, carrier="it")
    for message, key in (("query", "**/@tfbus/node/*"), ("put", "robot7/tf/other")):
        assert is_allowed(control, "it", message, key)
        assert not is_allowed(control, "leg", message, key)


@pytest.mark.parametrize(
    ("mode", "listen", "takes"),
    [
        ("client", (), True),
        ("client", ("tls/[::]:7447",), False),
        ("peer", (), False),
    ],
)
def test_only_a_client_without_clients_of_its_own_has_such_a_router(
    mode: str, listen: tuple[str, ...], takes: bool, tmp_path: Path
) -> None:
    """To others each process of the same identity may send what that may send, and no more."""
    pytest.importorskip("cryptography", reason="needs cryptography: pip install cryptography")
    from tfbus.bus.keystore import Keystore

    keystore = Keystore.init(tmp_path / "keys", days=10)
    keystore.add(Identity("it", "publisher", "robot7"), days=5)
    settings = NodeSettings(
        "it", mode=mode, listen=listen, connect=(), secure=str(keystore.path / "it")
    )
    control = json.loads(zenoh_config(settings).get_json("access_control"))
    assert is_allowed(control, "it", "put", "robot8/scan") is takes
