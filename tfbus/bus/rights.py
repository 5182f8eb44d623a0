"""The rights of each identity: in the words of the project, with patterns of names, and as Zenoh's
access control.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from tfbus.base.errors import SettingsError
from tfbus.base.structs import Struct, field, replace
from tfbus.base.wording import did_you_mean, listed
from tfbus.bus.patterns import as_keys, as_path, check_pattern, matches
from tfbus.wire.keys import STATIC_TRANSFORMS, TRANSFORMS, check_namespace, check_node_name, escape

EVERYTHING = ("**",)
NOTHING: tuple[str, ...] = ()

# The rights of roles if the file of rights does not say more; every role runs its own nodes.
_ROLES: Mapping[str, Mapping[str, tuple[str, ...]]] = {
    "reader": {},
    "publisher": dict.fromkeys(("frames", "topics", "serves", "calls"), EVERYTHING),
    "operator": dict.fromkeys(("topics", "calls", "sets"), EVERYTHING),
    "router": {},
    "admin": {
        **dict.fromkeys(("nodes", "frames", "serves", "calls", "sets"), EVERYTHING),
        "topics": (*EVERYTHING, "clock"),
    },
}
ROLES = tuple(_ROLES)
RIGHTS = ("nodes", "frames", "topics", "serves", "calls", "sets")

# Only for identities that name it: a clock is the time of all that follow it.
NAMED_ONLY = ("clock",)


class Identity(Struct):
    """An identity: its name by its certificate, and its rights.

    All names are within `namespace`, "" for all namespaces. Each right is a list of patterns, or
    None for the role's: names of its `nodes` and of their streams, besides NAME, NAME_* and
    _NAME_* in any namespace, which are its own; child `frames` that it
    publishes; `topics` that it publishes; services and actions that it `serves` and `calls`;
    parameters of other nodes that it `sets`, as node/parameter. Every identity may read all of its
    namespace. `hosts` are the names and addresses in its certificate. `revoked` is when its rights
    ended, as a date; "" while it has them.

    Raises SettingsError, or InvalidNameError for the name, for an invalid value.
    """

    name: str
    role: str
    namespace: str = ""
    nodes: tuple[str, ...] | None = None
    frames: tuple[str, ...] | None = None
    topics: tuple[str, ...] | None = None
    serves: tuple[str, ...] | None = None
    calls: tuple[str, ...] | None = None
    sets: tuple[str, ...] | None = None
    hosts: tuple[str, ...] = ()
    revoked: str = ""

    def __post_init__(self) -> None:
        check_node_name(self.name)
        if len(self.name) > 64:
            raise SettingsError(f"the name of an identity has at most 64 letters: {self.name!r}")
        if self.role not in _ROLES:
            raise SettingsError(
                f"{self.role!r} is no role{did_you_mean(self.role, ROLES)}; use one of "
                f"{', '.join(ROLES)}"
            )
        object.__setattr__(self, "namespace", check_namespace(self.namespace))
        for right in RIGHTS:
            for pattern in getattr(self, right) or ():
                check_pattern(pattern)

    def may(self, right: str) -> tuple[str, ...]:
        """The patterns of a right, by the role if none are given; none once revoked."""
        if self.revoked:
            return NOTHING
        given: tuple[str, ...] | None = getattr(self, right)
        rights = _ROLES[self.role].get(right, NOTHING) if given is None else given
        return (*self._own_nodes, *rights) if right == "nodes" else rights

    @property
    def _own_names(self) -> tuple[str, ...]:
        # Hidden ones, of tools, begin with _.
        return self.name, f"{self.name}_*", f"_{self.name}_*"

    @property
    def _own_nodes(self) -> tuple[str, ...]:
        return tuple(f"**/{name}" for name in self._own_names)

    def has_as_own(self, other: "Identity") -> bool:
        """Whether the name of another identity is one of its own nodes', if both may be."""
        return (
            self.name != other.name
            and any(matches(pattern, other.name) for pattern in self._own_names)
            and (self.is_within(other.namespace) or other.is_within(self.namespace))
        )

    def is_within(self, namespace: str) -> bool:
        """Whether a namespace is its own, or within it."""
        own = self.namespace
        return not own or namespace == own or namespace.startswith(f"{own}/")

    def allows(self, right: str, name: str) -> bool:
        """Whether it has a right for a name, relative to its namespace."""
        patterns = self.may(right)
        if right == "topics" and name in NAMED_ONLY:
            return name in patterns
        return any(matches(pattern, name) for pattern in patterns)

    def mistake_in(self, right: str, name: str, namespace: str = "") -> str:
        """Why it has not a right for a name, as a sentence; "" if it has.

        The name is relative to `namespace`, or absolute; a frame's is only a name. The name
        of a stream or a parameter is escaped, as in keys.
        """
        what = f"this identity, {self.name!r}, may not {_VERBS[right]} {_THINGS[right]} {name!r}"
        relative = name
        if right != "frames":
            absolute = (
                name if name.startswith("/") else "/".join(filter(None, ("", namespace, name)))
            )
            path = absolute.lstrip("/")
            if not self.is_within(path):
                return f"{what}: its namespace is {self.namespace!r}"
            relative = path.removeprefix(f"{self.namespace}/") if self.namespace else path
        return (
            f"{what}: {self._reason(right, relative)}" if not self.allows(right, relative) else ""
        )

    def _reason(self, right: str, name: str) -> str:
        """Why it may not, and the remedy."""
        if self.revoked:
            return f"it was revoked on {self.revoked}"
        change = self._change(right, name)
        if right == "nodes":
            *first, last = map(repr, (*self._own_names[:2], *(self.nodes or ())))
            return f"its nodes are {', '.join(first)} and {last}; rename the node, or {change}"
        if getattr(self, right) is None:
            return f"its role is {self.role}; {change}"
        return f"it may {_VERBS[right]} {listed(self.may(right)) or 'none'}; {change}"

    def _change(self, right: str, name: str) -> str:
        """How to give it a right, and where: the holder of the authority can."""
        if getattr(self, right) is not None:
            return f"add it to its '{right}' in rights.yaml, beside the authority"
        # Given patterns take the place of the role's; own nodes are always there.
        role = NOTHING if right == "nodes" else self.may(right)
        patterns = ", ".join(repr(each) if "*" in each else each for each in (*role, name))
        return f"give it `{right}: [{patterns}]` in rights.yaml, beside the authority"


def _owners(name: str) -> list[str]:
    """The names of identities that would have a name as one of their own nodes'."""
    parts = name.removeprefix("_").split("_")
    return ["_".join(parts[:count]) for count in range(1, len(parts))]


_VERBS = {
    "nodes": "run",
    "frames": "publish",
    "topics": "publish",
    "serves": "serve",
    "calls": "call",
    "sets": "set",
}
_THINGS = {
    "nodes": "node",
    "frames": "frame",
    "topics": "topic",
    "serves": "service",
    "calls": "service",
    "sets": "parameter",
}


class Rights(Struct):
    """The rights of all identities of one authority, by name.

    Raises SettingsError if one identity's name is that of another's own nodes.
    """

    identities: Mapping[str, Identity] = field(default_factory=dict)

    def __post_init__(self) -> None:
        valid = [each for each in self.identities.values() if not each.revoked]
        at = {each.name: each for each in valid}
        for identity in valid:
            for owner in _owners(identity.name):
                if owner in at and at[owner].has_as_own(identity):
                    raise SettingsError(
                        f"{identity.name!r} cannot be an identity's name: identity {owner!r} has "
                        f"{owner}_* for its own nodes; use {identity.name.replace('_', '-')!r}"
                    )

    def identity(self, name: str) -> Identity:
        """The identity of this name. Raises SettingsError if there is none."""
        if name not in self.identities:
            raise SettingsError(
                f"there is no identity {name!r}{did_you_mean(name, self.identities)}"
            )
        return self.identities[name]

    def seen_by(self, identity: Identity) -> "Rights":
        """The identities that can send an identity anything: not of namespaces beside its
        own. In a large fleet these are few.
        """
        if identity.role == "router":
            return self
        return Rights(
            {
                name: other
                for name, other in self.identities.items()
                if other.role == "router"
                or identity.is_within(other.namespace)
                or other.is_within(identity.namespace)
            }
        )

    @property
    def names_hosts(self) -> bool:
        """Whether every identity names its hosts, so that connecting can check them."""
        valid = [each for each in self.identities.values() if not each.revoked]
        return bool(valid) and all(each.hosts for each in valid)

    def frames_of_stream(self, stream: str, namespace: str) -> tuple[str, ...] | None:
        """The child frames that may come on a stream, by the rights of its possible publishers;
        None for all.

        A stream that no identity can have by these rights has come through a router with later
        ones, which enforces them.
        """
        if not self._is_known(stream, namespace):
            return None
        patterns: list[str] = []
        for identity in self._publishers_of(stream, namespace):
            own = identity.may("frames")
            if "**" in own:
                return None
            patterns.extend(own)
        return tuple(patterns)

    def may_be_of(self, node: str, stream: str, namespace: str) -> bool:
        """Whether one identity may both publish a stream and run a node of this full name; true of
        a stream that is not known here, as in `frames_of_stream`.
        """
        return not self._is_known(stream, namespace) or any(
            not identity.mistake_in("nodes", node)
            for identity in self._publishers_of(stream, namespace)
        )

    def _is_known(self, stream: str, namespace: str) -> bool:
        """Whether an identity, revoked or not, has or had nodes of a stream's name."""
        name = escape(stream)
        return any(
            not replace(identity, revoked="").mistake_in("nodes", name, namespace)
            for identity in self.identities.values()
        )

    def _publishers_of(self, stream: str, namespace: str) -> list[Identity]:
        """The identities that may publish a stream: an admin only if it is of no other identity."""
        name = escape(stream)
        found = [
            identity
            for identity in self.identities.values()
            if identity.may("frames") and not identity.mistake_in("nodes", name, namespace)
        ]
        return [each for each in found if each.role != "admin"] or found


# Messages, as Zenoh's access control calls them.
_SUBSCRIBE = "declare_subscriber"
_WATCH = ("liveliness_query", "declare_liveliness_subscriber")
_SERVE = ("declare_queryable", "reply")
_PUBLISH = ("put", "delete")
_ALIVE = "liveliness_token"
_ALL = (*_PUBLISH, _SUBSCRIBE, "query", *_SERVE, _ALIVE, *_WATCH)

# Zenoh's advanced publishers and subscribers have tokens, and retained messages, below their key.
_RETAINED = "/@adv/**"
_SUBSCRIBED = "/@adv/sub/**"

# The messages that a process sends on a key of its own.
_SENT = (*_PUBLISH, *_SERVE, _ALIVE)

# `**` stands for no chunk that begins with @.
_EVERY_KEY = ("**", "**/@tfbus/**", "**/@adv/**", "**/@tfbus/**/@adv/**")

# A pattern of topics or services stands for none of these.
_NOT_BY_PATTERN = (
    *(f"**/{kind}/**" for kind in (TRANSFORMS, STATIC_TRANSFORMS)),
    *(f"**/{kind}/**{_RETAINED}" for kind in (TRANSFORMS, STATIC_TRANSFORMS)),
    *(f"**/{name}" for name in NAMED_ONLY),
)


def access_control(rights: Rights, carrier: str = "") -> dict[str, Any]:
    """Zenoh's setting `access_control` for a process on the bus of these rights: the messages that
    each identity may send, by key. The identity `carrier` passes on messages of others too, as the
    router of a robot does to clients of the same identity, and enforces their rights.

    Every process enforces it on incoming messages; and on outgoing ones, only the ones that an
    identity may read. An identity with a namespace gets nothing of others: not even the tokens that
    all peers get unasked, or the messages of a client to a process that says that it is a router.
    Of other namespaces it may see only which keys others subscribe to, and ask for.

    Zenoh decides by subjects, which here are the common names of certificates. Within one subject
    a denial counts more than a permission; of two subjects that fit the same certificate, one that
    allows is enough. So each identity is two subjects: one of its own keys, which are exact; and
    one of the names that it chooses itself, topics and services, for which patterns may be wide:
    there the keys of transforms and the clock are denied.
    """
    rules: list[dict[str, Any]] = []
    subjects: list[dict[str, Any]] = []
    policies: list[dict[str, Any]] = []
    for identity in rights.identities.values():
        if identity.revoked:
            continue
        carried = [_rule(_ALL, _EVERY_KEY)] if identity.name == carrier else []
        own = [*_own(identity), *carried]
        for what, its_rules in (("own", own), ("chosen", _chosen(identity))):
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
        # It carries the messages of others, and enforces their rights.
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
        # Subscriptions of a fleet's tools are for all namespaces.
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
    """The rules of topics and services, whose names may be anything but keys of transforms."""
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
        # The last message of a topic is the answer to late subscribers, at the topic's own key.
        rules.append(_rule((*_PUBLISH, "reply"), topics))
    if serves := keys("serves"):
        rules.append(_rule(_SERVE, [*serves, *keys("serves", "/cancel")]))
    if calls := keys("calls"):
        rules.append(_rule(["query"], [*calls, *keys("calls", "/cancel")]))
    if rules:
        rules.append(_rule(_SENT, _NOT_BY_PATTERN, permission="deny"))
    return rules
