"""Checks of a closed bus, or of how open an open one is."""

from datetime import UTC, datetime, timedelta

from tfbus.doctor.examination import Examination
from tfbus.doctor.finding import Finding, first_of, found, ok, skipped
from tfbus.wording import counted, listed

_SOON = timedelta(days=30)

_OPEN = "it is an open bus"


def check_encryption(seen: Examination) -> Finding:
    """The bus is closed, or open to this machine only."""
    closed = seen.settings.closed
    if closed is not None:
        identity = closed.identity
        return ok(f"encrypted; this is identity {identity.name!r}, {identity.role}")
    beyond = list(seen.host.listens_beyond)
    evidence = [
        f"it listens on {listed(beyond)}, and any process that reaches it can read everything, "
        "send any frame, call any service and set any parameter"
    ]
    return found(
        "warn",
        evidence if beyond else [],
        "on a network that others use: tfbus keys init, and --secure (docs/guide/security.md)",
        "open, to this machine only",
    )


def check_certificate(seen: Examination) -> Finding:
    """The certificate of this identity is valid for a while."""
    closed = seen.settings.closed
    if closed is None:
        return skipped(_OPEN)
    left = closed.ends - datetime.now(UTC)
    name = closed.identity.name
    evidence = [f"that of {name!r} expires on {closed.ends:%Y-%m-%d}, in {left.days} days"]
    return found(
        "warn",
        evidence if left < _SOON else [],
        f"tfbus keys renew {name}, and export it to this machine",
        f"valid until {closed.ends:%Y-%m-%d}",
    )


def check_rights(seen: Examination) -> Finding:
    """All nodes enforce the same rights, and none is wider than its role needs."""
    closed = seen.settings.closed
    if closed is None:
        return skipped(_OPEN)
    others = [each.name for each in seen.nodes if each.rights and each.rights != closed.digest]
    wide = [
        f"{identity.name} may be any node, and so publish any stream"
        for identity in closed.rights.identities.values()
        if identity.role == "publisher"
        and not identity.revoked
        and {"*", "**", "**/*"}.intersection(identity.nodes or ())
    ]
    if others:
        return Finding(
            "fail",
            (f"{counted(len(others), 'node')} with other rights than these: {listed(others)}",),
            "copy the last rights.yaml to every machine (tfbus keys export), and restart its nodes",
        )
    return found(
        "warn",
        first_of(wide),
        "name its nodes in rights.yaml",
        f"{counted(len(closed.rights.identities), 'name')} in them",
    )
