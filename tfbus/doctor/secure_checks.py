"""Checks of a closed bus, or of how open an open one is."""

from datetime import UTC, datetime, timedelta

from tfbus.doctor.examination import Examination
from tfbus.doctor.finding import Finding, first_of, found, ok, skipped
from tfbus.wording import counted, listed

_SOON = timedelta(days=30)

_OPEN = "it is an open bus"


def check_encryption(seen: Examination) -> Finding:
    """The bus is closed, or no other machine is on it."""
    closed = seen.settings.closed
    if closed is not None:
        identity = closed.identity
        return ok(f"encrypted; this is identity {identity.name!r}, {identity.role}")
    beyond = list(seen.host.listens_beyond)
    if not beyond:
        return ok("open, to this machine only")
    others = sorted({node.host for node in seen.nodes} - {seen.host.name})
    if not others and not seen.host.routers:
        return ok("open; no other machine is on it now; --secure closes it")
    who = f"{listed(others)} {'is' if len(others) == 1 else 'are'} on it" if others else "routed"
    evidence = [
        f"an open bus; {who}, and any process that reaches {listed(beyond)} can read everything, "
        "send any frame, call any service and set any parameter"
    ]
    return found(
        "warn",
        evidence,
        "on a network that others use: tfbus keys init, and --secure (docs/guide/security.md)",
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
