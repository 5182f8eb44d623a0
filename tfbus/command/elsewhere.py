"""Robots in namespaces below, for programs that find nothing in their own."""

from tfbus.bus.session import Session
from tfbus.discover.graph import graph_of
from tfbus.discover.presence import describe_all


def namespaces_serving(session: Session, service: str) -> list[str]:
    """The namespaces below that have this service or action, sorted; asks all nodes, within 1 s."""
    nodes = describe_all(session, lambda error: None)
    services = graph_of(nodes, {}, session.settings.namespace).services.values()
    return sorted(
        each.name.removesuffix(f"/{service}")
        for each in services
        if each.servers and each.name.endswith(f"/{service}")
    )
