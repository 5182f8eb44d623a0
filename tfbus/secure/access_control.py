"""Rights as Zenoh's access control: which identity may send what on which keys.

Every process enforces it on what comes in; and on what goes out, which is only what an identity may
read. An identity with a namespace gets nothing of others: not even the tokens that all peers get
unasked, or what a client sends to a process that says that it is a router. Of other namespaces it
may see only which keys others subscribe to, and ask for.

Zenoh decides by subjects, which here are the common names of certificates. Within one subject what
is denied counts more than what is allowed; of two subjects that fit the same certificate, one that
allows is enough. So each identity is two subjects: that of its own keys, which are exact; and that
of the names that it chooses itself, topics and services, for which patterns may be wide: there the
keys of transforms and the clock are denied.
"""

from collections.abc import Iterable, Sequence
from typing import Any

from tfbus.secure.rights import NAMED_ONLY, Identity, Rights, as_keys, as_path
from tfbus.wire.keys import STATIC_TRANSFORMS, TRANSFORMS

_SUBSCRIBE = "declare_subscriber"
_WATCH = ("liveliness_query", "declare_liveliness_subscriber")
_SERVE = ("declare_queryable", "reply")
_PUBLISH = ("put", "delete")
_ALIVE = "liveliness_token"
_ALL = (*_PUBLISH, _SUBSCRIBE, "query", *_SERVE, _ALIVE, *_WATCH)

# Zenoh's advanced publishers and subscribers have tokens, and what they retain, below their key.
_RETAINED = "/@adv/**"
_SUBSCRIBED = "/@adv/sub/**"

# What a process sends on a key of its own.
_SENT = (*_PUBLISH, *_SERVE, _ALIVE)

# `**` stands for no chunk that begins with @.
_EVERY_KEY = ("**", "**/@tfbus/**", "**/@adv/**", "**/@tfbus/**/@adv/**")

# A pattern of topics or services stands for none of these.
_NOT_BY_PATTERN = (
    *(f"**/{kind}/**" for kind in (TRANSFORMS, STATIC_TRANSFORMS)),
    *(f"**/{kind}/**{_RETAINED}" for kind in (TRANSFORMS, STATIC_TRANSFORMS)),
    *(f"**/{name}" for name in NAMED_ONLY),
)


def access_control(rights: Rights) -> dict[str, Any]:
    """Zenoh's setting `access_control` for a process on the bus of these rights."""
    rules: list[dict[str, Any]] = []
    subjects: list[dict[str, Any]] = []
    policies: list[dict[str, Any]] = []
    for identity in rights.identities.values():
        if identity.revoked:
            continue
        for what, its_rules in (("own", _own(identity)), ("chosen", _chosen(identity))):
            subject = f"{identity.name} {what}"
            found = [{"id": f"{subject} {number}", **rule} for number, rule in enumerate(its_rules)]
            if found:
                rules.extend(found)
                subjects.append(_subject(subject, identity.name, is_second=what == "chosen"))
                policies.append({"rules": [rule["id"] for rule in found], "subjects": [subject]})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    }


def _subject(subject: str, name: str, *, is_second: bool) -> dict[str, Any]:
    # Zenoh takes two subjects of the same properties as one. All links are TLS.
    protocols = {"link_protocols": ["tls"]} if is_second else {}
    return {"id": subject, "cert_common_names": [name], **protocols}


def _rule(
    messages: Iterable[str], keys: Iterable[str], flow: str = "ingress", permission: str = "allow"
) -> dict[str, Any]:
    return {
        "permission": permission,
        "flows": [flow],
        "messages": list(messages),
        "key_exprs": list(dict.fromkeys(keys)),
    }


def _own(identity: Identity) -> list[dict[str, Any]]:
    """The rules of keys that an identity has, or that it names exactly."""
    if identity.role == "router":
        # It carries what others send, and enforces their rights.
        return [_rule(_ALL, _EVERY_KEY, "egress"), _rule(_ALL, _EVERY_KEY)]
    within = f"{identity.namespace}/" if identity.namespace else ""
    rules = [
        *_receiving(within),
        *_reading(within),
    ]
    rules += _presence(within, identity.may("nodes"))
    if identity.may("frames"):
        rules += _streams(within, identity.may("nodes"))
    if named := [topic for topic in identity.may("topics") if topic in NAMED_ONLY]:
        rules.append(_rule(_PUBLISH, [f"{within}{topic}" for topic in named]))
    if sets := identity.may("sets"):
        rules.append(
            _rule(["query"], [f"{within}{key}" for each in sets for key in _set_keys(each)])
        )
    return rules


def _set_keys(pattern: str) -> list[str]:
    """The key expressions to set the parameters of a pattern `node/parameter`."""
    node, _, parameter = pattern.rpartition("/")
    if pattern.endswith("**"):
        node, parameter = pattern, "*"
    return [f"{key}/{as_path(parameter)}" for key in as_keys(node or "*", "@tfbus/set")]


def _receiving(within: str) -> list[dict[str, Any]]:
    """The keys that others may send to it."""
    everything = [f"{within}{key}" for key in _EVERY_KEY]
    if not within:
        return [_rule(_ALL, everything, "egress")]
    return [
        _rule([*_PUBLISH, *_SERVE, _ALIVE, "query"], everything, "egress"),
        # Those of a fleet's tools are for all namespaces.
        _rule([_SUBSCRIBE, *_WATCH], _EVERY_KEY, "egress"),
        _rule(["query"], _asked(""), "egress"),
    ]


def _asked(within: str) -> list[str]:
    """The keys at which any identity may ask."""
    return [
        *(f"{within}**/{kind}/**" for kind in (TRANSFORMS, STATIC_TRANSFORMS)),
        *(f"{within}**/@tfbus/{kind}/**" for kind in ("stream", "node", "clock", "kept", "param")),
        *(f"{within}{key}" for key in _EVERY_KEY if key.endswith(_RETAINED)),
    ]


def _reading(within: str) -> list[dict[str, Any]]:
    everything = [f"{within}{key}" for key in _EVERY_KEY]
    return [
        _rule([_SUBSCRIBE, *_WATCH], everything),
        _rule(["query"], _asked(within)),
        _rule([_ALIVE], [f"{within}{key}{_SUBSCRIBED}" for key in ("**", "**/@tfbus/**")]),
    ]


def _presence(within: str, nodes: Sequence[str]) -> list[dict[str, Any]]:
    alive = _keys(within, nodes, "@tfbus/node")
    clocks = _keys(within, nodes, "@tfbus/clock")
    kept = _keys(within, nodes, "@tfbus/kept")
    parameters = [*_keys(within, nodes, "@tfbus/param"), *_keys(within, nodes, "@tfbus/set")]
    served = [*alive, *clocks, *kept, *(f"{key}/**" for key in parameters)]
    return [_rule([_ALIVE], [*alive, *kept]), _rule(_SERVE, served)]


def _streams(within: str, streams: Sequence[str]) -> list[dict[str, Any]]:
    dynamic = [f"{key}/**" for key in _keys(within, streams, TRANSFORMS)]
    retained = [
        *_keys(within, streams, STATIC_TRANSFORMS),
        *_keys(within, streams, "@tfbus/stream"),
    ]
    below = [f"{key}{_RETAINED}" for key in retained]
    return [
        _rule([*_PUBLISH, *_SERVE], [*dynamic, *retained, *below]),
        _rule([_ALIVE], [*retained, *below]),
    ]


def _keys(within: str, patterns: Sequence[str], kind: str) -> list[str]:
    return [f"{within}{key}" for pattern in patterns for key in as_keys(pattern, kind)]


def _chosen(identity: Identity) -> list[dict[str, Any]]:
    """The rules of topics and services, whose names may be anything but those of transforms."""
    if identity.role == "router":
        return []
    within = f"{identity.namespace}/" if identity.namespace else ""

    def keys(right: str, below: str = "") -> list[str]:
        patterns = [each for each in identity.may(right) if each not in NAMED_ONLY]
        return [f"{within}{as_path(pattern)}{below}" for pattern in patterns]

    rules = []
    if topics := keys("topics"):
        retained = keys("topics", _RETAINED)
        rules.append(_rule(_SENT, retained))
        # The last message of a topic is the answer to who joins late, at the topic's own key.
        rules.append(_rule((*_PUBLISH, "reply"), topics))
    if serves := keys("serves"):
        rules.append(_rule(_SERVE, [*serves, *keys("serves", "/cancel")]))
    if calls := keys("calls"):
        rules.append(_rule(["query"], [*calls, *keys("calls", "/cancel")]))
    if rules:
        rules.append(_rule(_SENT, _NOT_BY_PATTERN, permission="deny"))
    return rules
